"""Lines that may be there: from a corner parallel to a line near it, and from corner to corner."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.match.guided.corners import Corners, Ends, mm_per_px
from trinoc.match.guided.state import State
from trinoc.match.tuning import GuidedTuning

# Directions nearer than this are one, degrees.
_SAME_DEG = 4.0


class Hypotheses(NamedTuple):
    """ends_mm : (n, 2, 3) where a line may begin and end. covariance_mm2 : (n, 6, 6) of them."""

    ends_mm: Float[np.ndarray, "n 2 3"]
    covariance_mm2: Float[np.ndarray, "n 6 6"]


def hypotheses_of(state: State, ends: Ends, corners: Corners, tuning: GuidedTuning) -> Hypotheses:
    """Of both kinds, without those where a line begins already."""
    parts = [_parallel(state, ends, corners, tuning), _between(state, ends, corners, tuning)]
    lines = np.concatenate([part.ends_mm for part in parts])
    covariance = np.concatenate([part.covariance_mm2 for part in parts])
    size = mm_per_px(state, lines.mean(axis=1))
    long = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) > tuning.shortest_px * size
    return Hypotheses(lines[long], covariance[long])


def _outward(state: State) -> Float[np.ndarray, "n 3"]:
    """From each end into its line."""
    way = state.tracks.ends_mm[:, 1] - state.tracks.ends_mm[:, 0]
    unit = way / np.linalg.norm(way, axis=1)[:, None]
    return np.stack([unit, -unit], axis=1).reshape(-1, 3)


def _taken(
    ends: Ends, outward: np.ndarray, corner: Int[np.ndarray, "n"], unit: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "n"]:
    """Whether a line leaves each corner in this direction already."""
    taken = np.zeros(len(corner), dtype=bool)
    order = np.argsort(ends.corner, kind="stable")
    bounds = np.searchsorted(ends.corner[order], np.arange(ends.corner.max() + 2))
    for row, place in enumerate(corner.tolist()):
        own = order[bounds[place] : bounds[place + 1]]
        taken[row] = (outward[own] @ unit[row]).max() > np.cos(np.radians(_SAME_DEG))
    return taken


def _parallel(state: State, ends: Ends, corners: Corners, tuning: GuidedTuning) -> Hypotheses:
    tracks = state.tracks
    way = tracks.ends_mm[:, 1] - tracks.ends_mm[:, 0]
    length = np.linalg.norm(way, axis=1)
    unit = way / length[:, None]
    # The nearest lines by their three places.
    known = np.concatenate(
        [tracks.ends_mm[:, 0], tracks.ends_mm.mean(axis=1), tracks.ends_mm[:, 1]]
    )
    most = min(3 * tuning.partners, len(known))
    near = np.asarray(KDTree(known).query(corners.place_mm, most)[1]).reshape(-1, most)
    rows: list[tuple[int, int, float]] = []
    everywhere = _usual(unit, length, tuning)
    for place, own in enumerate((near % len(length)).tolist()):
        lines = np.array(
            list(dict.fromkeys([*own, *everywhere]))[: tuning.partners + len(everywhere)]
        )
        alike = np.abs(unit[lines] @ unit[lines].T) > np.cos(np.radians(_SAME_DEG))
        seen: list[int] = []
        for k in np.argsort(-length[lines]).tolist():
            if not any(alike[k, other] for other in seen):
                seen.append(k)
                reach = tuning.longer * float(length[lines[k]])
                rows += [(place, int(lines[k]), reach), (place, int(lines[k]), -reach)]
    place, line = np.array([row[:2] for row in rows], dtype=np.int64).reshape(-1, 2).T
    reach = np.array([row[2] for row in rows])
    step = reach[:, None] * unit[line]
    free = ~_taken(ends, _outward(state), place, step / np.abs(reach)[:, None])
    place, line, step, reach = place[free], line[free], step[free], np.abs(reach[free])
    turn = tracks.covariance_mm2[line].reshape(-1, 2, 3, 2, 3)
    turn = turn[:, 0, :, 0] + turn[:, 1, :, 1] - turn[:, 0, :, 1] - turn[:, 1, :, 0]
    turn = turn / (length[line] ** 2)[:, None, None]
    turn = turn + np.radians(tuning.parallel_deg) ** 2 * np.eye(3)
    start = corners.place_mm[place]
    covariance = np.tile(corners.covariance_mm2[place], (1, 2, 2))
    covariance[:, 3:, 3:] += (reach**2)[:, None, None] * turn
    return Hypotheses(np.stack([start, start + step], axis=1), covariance)


def _usual(
    unit: Float[np.ndarray, "t 3"], length: Float[np.ndarray, "t"], tuning: GuidedTuning
) -> list[int]:
    """The line nearest to the mean length of each of the directions that most lines have."""
    alike = np.abs(unit @ unit.T) > np.cos(np.radians(_SAME_DEG))
    left, found = length.copy(), []
    for _ in range(min(tuning.usual_directions, len(length))):
        weight = alike @ left
        family = np.flatnonzero(alike[weight.argmax()] & (left > 0))
        if len(family) < 3:
            break
        found.append(int(family[np.argsort(length[family])[len(family) // 2]]))
        left[family] = 0.0
    return found


def _between(state: State, ends: Ends, corners: Corners, tuning: GuidedTuning) -> Hypotheses:
    most = min(tuning.corners + 1, len(corners.place_mm))
    near = np.asarray(KDTree(corners.place_mm).query(corners.place_mm, most)[1])
    one, other = np.repeat(np.arange(len(near)), most), near.reshape(-1)
    pair = np.unique(np.sort(np.stack([one, other], axis=1), axis=1), axis=0)
    one, other = pair[pair[:, 0] != pair[:, 1]].T
    step = corners.place_mm[other] - corners.place_mm[one]
    unit = step / np.maximum(np.linalg.norm(step, axis=1), 1e-9)[:, None]
    outward = _outward(state)
    free = ~_taken(ends, outward, one, unit) & ~_taken(ends, outward, other, -unit)
    one, other = one[free], other[free]
    covariance = np.zeros((len(one), 6, 6))
    covariance[:, :3, :3] = corners.covariance_mm2[one]
    covariance[:, 3:, 3:] = corners.covariance_mm2[other]
    return Hypotheses(
        np.stack([corners.place_mm[one], corners.place_mm[other]], axis=1), covariance
    )
