"""Cameras and boards that are connected by how they move, where no camera sees two boards."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.motions import chained, inverse
from trinoc.calib.shots.chain import PairLink
from trinoc.calib.shots.hand_eye import FEWEST_SHOTS, hand_eye
from trinoc.calib.shots.sightings import Sighting
from trinoc.calib.targets import AbstractTarget

Poses = dict[int, Float[np.ndarray, "3 4"]]
Links = dict[tuple[int, int], PairLink]
# Subsets of shots that are tried where all of them together do not agree, and their size.
_TRIES, _SUBSET = 60, 4


def moving_together(
    placed: Mapping[int, Sequence[Sighting]],
    cameras: Sequence[Poses],
    groups: Sequence[Poses],
    target: AbstractTarget,
) -> tuple[Links, Links] | None:
    """Two groups of cameras and two of boards that move as if both were fixed to each other."""
    best = None
    for g, h in combinations(range(len(cameras)), 2):
        for p in range(len(groups)):
            for q in range(len(groups)):
                if p == q:
                    continue
                first = _by_shot(placed, cameras[g], groups[p])
                second = _by_shot(placed, cameras[h], groups[q])
                shots = sorted(set(first) & set(second))
                pairs = [(first[shot], second[shot]) for shot in shots]
                found = _agreed(pairs, cameras[g], cameras[h], target)
                if found is not None and (best is None or found[2] > best[0]):
                    best = found[2], (g, h), (p, q), found
    if best is None:
        return None
    agreeing, (g, h), (p, q), (between_cameras, between_boards, _, shared) = best
    ends = min(cameras[g]), min(cameras[h])
    fixed = min(groups[p]), min(groups[q])
    return (
        {ends: PairLink(between_cameras, shared, agreeing)},
        {fixed: PairLink(inverse(between_boards), shared, agreeing)},
    )


def _by_shot(
    placed: Mapping[int, Sequence[Sighting]], cameras: Poses, boards: Poses
) -> dict[int, Sighting]:
    """The sighting with most places of each shot, of these cameras and boards."""
    best: dict[int, Sighting] = {}
    for camera in cameras:
        for each in placed[camera]:
            if each.board not in boards:
                continue
            known = best.get(each.shot)
            if known is None or len(each.detections[0]) > len(known.detections[0]):
                best[each.shot] = each
    return best


class _Agreed(NamedTuple):
    """Motions between two groups of cameras and of boards, and how many pairs of all agree."""

    cameras: Float[np.ndarray, "3 4"]
    boards: Float[np.ndarray, "3 4"]
    agreeing: int
    shared: int


def _agreed(
    pairs: Sequence[tuple[Sighting, Sighting]],
    cameras: Poses,
    other_cameras: Poses,
    target: AbstractTarget,
) -> _Agreed | None:
    """What most pairs agree on: by all shots, by few of them, and by those that agreed."""
    count = len(pairs)
    if count < FEWEST_SHOTS:
        return None
    first = np.stack([chained(inverse(cameras[a.camera]), a.cam_from_set[0]) for a, _ in pairs])
    second = np.stack(
        [chained(inverse(other_cameras[b.camera]), b.cam_from_set[0]) for _, b in pairs]
    )

    def judged(rows: np.ndarray) -> tuple[_Agreed, np.ndarray] | None:
        found = hand_eye(first[rows], second[rows])
        if found is None:
            return None
        agrees = np.zeros(count, dtype=bool)
        for k, (_, b) in enumerate(pairs):
            pose = chained(chained(found.cameras, first[k]), found.boards)
            _, miss = b.nearest(chained(other_cameras[b.camera], pose), target)
            agrees[k] = miss < b.agreement_px
        return _Agreed(found.cameras, found.boards, int(agrees.sum()), count), agrees

    random, tried = np.random.default_rng(0), [np.arange(count)]
    if count > _SUBSET:
        tried += [random.choice(count, _SUBSET, replace=False) for _ in range(_TRIES)]
    best, agrees = None, None
    for rows in tried:
        found = judged(rows)
        if found is not None and (best is None or found[0].agreeing > best.agreeing):
            best, agrees = found
        if best is not None and best.agreeing == count:
            return best
    if best is None or agrees is None or best.agreeing < FEWEST_SHOTS:
        return None
    again = judged(np.flatnonzero(agrees))
    best = again[0] if again is not None and again[0].agreeing >= best.agreeing else best
    return best if 2 * best.agreeing > count else None
