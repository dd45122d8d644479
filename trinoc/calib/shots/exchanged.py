"""Two cameras' pictures of one shot that were given under each other's names."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from trinoc.calib.shots.chain import placed_shot
from trinoc.calib.shots.lens_start import with_poses
from trinoc.calib.shots.sightings import Sighting
from trinoc.calib.targets import AbstractTarget
from trinoc.errors import CalibrationError


def exchanged_pair(
    sightings: Sequence[Sighting],
    cam_from_rig: dict[int, Float[np.ndarray, "3 4"]],
    target: AbstractTarget,
) -> tuple[int, int] | None:
    """Two cameras that agree with all others of a shot once their pictures change places.

    None where no pair does, or more than one: with few cameras chance could choose.
    """
    found = []
    for a, b in combinations(range(len(sightings)), 2):
        if sightings[a].detections[0].image_size_px != sightings[b].detections[0].image_size_px:
            continue
        try:
            trial = list(sightings)
            trial[a] = _through(sightings[a], sightings[b], target)
            trial[b] = _through(sightings[b], sightings[a], target)
        except CalibrationError:
            continue
        if not placed_shot(trial, cam_from_rig, target).stragglers:
            found.append((sightings[a].camera, sightings[b].camera))
    return found[0] if len(found) == 1 else None


def _through(owner: Sighting, other: Sighting, target: AbstractTarget) -> Sighting:
    """What `other` detected, in each labelling, as if the camera of `owner` had seen it."""
    poses = with_poses(owner.lens, other.detections, target).cam_from_board
    return owner._replace(detections=other.detections, cam_from_board=tuple(poses))
