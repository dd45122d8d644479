"""From what each camera saw to cameras in one frame and a board in every shot."""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection import Detection
from trinoc.calib.shots.chain import PairLink, linked_groups, pair_link, placed_shot
from trinoc.calib.shots.exchanged import exchanged_pair
from trinoc.calib.shots.lens_start import CameraStart
from trinoc.calib.shots.motions import boards_parallel
from trinoc.calib.shots.sightings import Sighting, sighting
from trinoc.calib.shots.table import View
from trinoc.calib.targets import AbstractTarget
from trinoc.errors import CalibrationError

# Cameras whose pictures were counted differently are tried this many shots apart.
_MOST_SHIFT = 3
# What the name of a shot goes on with where one camera's picture of it stands for itself.
_ALONE = " of {} alone"


class PlacedRig(NamedTuple):
    """A start for the joint fit.

    Fields
    ------
    cam_from_rig : (c, 3, 4).
    rig_from_board : (s, 3, 4) of each shot, those included that were split off.
    shots : the name of each.
    views : what was seen, labelled.
    refused : sentences on pictures that show the board elsewhere than the others of their shot.
    """

    cam_from_rig: Float[np.ndarray, "c 3 4"]
    rig_from_board: Float[np.ndarray, "s 3 4"]
    shots: tuple[str, ...]
    views: tuple[View, ...]
    refused: tuple[str, ...]


def placed_rig(
    starts: Mapping[str, CameraStart],
    detections: Mapping[str, Mapping[str, Detection]],
    shots: Sequence[str],
    target: AbstractTarget,
    known: Collection[str] = (),
) -> PlacedRig:
    """Chain the cameras and place the board of every shot. `known` : cameras with a given lens.

    A picture that shows the board elsewhere than the other cameras of its shot keeps a board of
    its own: it still speaks of its lens. Raises CalibrationError where cameras are not connected,
    naming the groups, or out of step.
    """
    names = list(starts)
    seen = {
        camera: {
            shots.index(shot): sighting(k, shots.index(shot), start.lens, each, pose, target)
            for (shot, each), pose in zip(
                detections[camera].items(), start.cam_from_board, strict=True
            )
        }
        for k, (camera, start) in enumerate(starts.items())
    }
    links = {}
    for a, b in combinations(range(len(names)), 2):
        shared = sorted(set(seen[names[a]]) & set(seen[names[b]]))
        if shared:
            first, second = ([seen[names[k]][shot] for shot in shared] for k in (a, b))
            links[a, b] = pair_link(first, second, target)
    groups = linked_groups(links, range(len(names)))
    if len(groups) > 1:
        raise CalibrationError(_apart(groups, links, names, seen, target, known))
    poses = groups[0]
    boards, taken, views, refused = [], [], [], []
    for number, shot in enumerate(shots):
        own = [seen[camera][number] for camera in names if number in seen[camera]]
        if not own:
            continue
        placed = placed_shot(own, poses, target)
        views += [_view(each, labelling, len(boards)) for each, labelling in placed.members]
        boards.append(placed.rig_from_board)
        taken.append(shot)
        if placed.stragglers and (pair := exchanged_pair(own, poses, target)):
            a, b = (names[camera] for camera in pair)
            refused.append(
                f'{shot}: the pictures of "{a}" and "{b}" look exchanged: with each under the '
                "other's name, all cameras show the board in one place."
            )
        for straggler, miss in placed.stragglers:
            alone = placed_shot([straggler], poses, target)
            views.append(_view(straggler, 0, len(boards)))
            boards.append(alone.rig_from_board)
            taken.append(f"{shot}{_ALONE.format(names[straggler.camera])}")
            others = ", ".join(names[each.camera] for each, _ in placed.members)
            refused.append(
                f'{shot}: "{names[straggler.camera]}" shows the board {miss:.0f} px from where '
                f"{others} show{'s' if len(placed.members) == 1 else ''} it, so it was not "
                "taken at the same moment, or shows another board that looks alike; it serves for "
                "its lens alone."
            )
    stacked = np.stack([poses[k] for k in range(len(names))])
    return PlacedRig(stacked, np.stack(boards), tuple(taken), tuple(views), tuple(refused))


def of_one_moment(shot: str, camera: str) -> str:
    """The shot as it was given, from its name in a `PlacedRig`."""
    return shot.removesuffix(_ALONE.format(camera))


def _view(seen: Sighting, labelling: int, shot: int) -> View:
    detection = seen.detections[labelling]
    return View(seen.camera, shot, detection, np.ones(len(detection), dtype=bool))


def _apart(
    groups: list[dict[int, np.ndarray]],
    links: dict[tuple[int, int], PairLink],
    names: list[str],
    seen: dict[str, dict[int, Sighting]],
    target: AbstractTarget,
    known: Collection[str],
) -> str:
    """Why the cameras are not in one frame."""
    broken = [(pair, link) for pair, link in links.items() if not link.holds]
    for (a, b), _ in broken:
        shift = _shift_between(seen[names[a]], seen[names[b]], target)
        if shift:
            earlier = "earlier" if shift > 0 else "later"
            return (
                f'The pictures of "{names[b]}" fit those of "{names[a]}" that were taken '
                f"{abs(shift)} shot{'' if abs(shift) == 1 else 's'} {earlier}: the cameras are out "
                "of step; leave out the pictures that only one of them has, or name them alike."
            )
    parts = "; ".join(", ".join(names[k] for k in sorted(group)) for group in groups)
    if broken:
        (a, b), link = broken[0]
        for camera in (names[a], names[b]):
            poses = [each.cam_from_board[0] for each in seen[camera].values()]
            if camera not in known and boards_parallel(poses):
                return (
                    f'The board is parallel in all shots of "{camera}", which tells no lens, and '
                    "without its lens not how it stands. Tilt the board by 30 to 50 degrees, "
                    "another way each time, or give the lenses."
                )
        return (
            f'"{names[a]}" and "{names[b]}" share {link.shared} shots, but only {link.agreeing} of '
            f"them agree on how the cameras stand (the groups are {parts}): see that pictures of "
            "equal names are of one moment, that no picture is mirrored, and that the cameras "
            "did not move."
        )
    return (
        f"No shot connects the cameras: the groups are {parts}. Show the board to cameras of two "
        "groups at once, in two shots at least."
    )


def _shift_between(
    first: dict[int, Sighting], second: dict[int, Sighting], target: AbstractTarget
) -> int:
    """By how many shots the second camera's pictures come too late; 0 where no shift helps."""
    for size in range(1, _MOST_SHIFT + 1):
        for shift in (size, -size):
            shared = sorted(shot for shot in first if shot + shift in second)
            if len(shared) < 3:
                continue
            link = pair_link(
                [first[shot] for shot in shared], [second[shot + shift] for shot in shared], target
            )
            if 2 * link.agreeing > link.shared:
                return shift
    return 0
