"""What speaks for a shadow without the lamp: levels beside it, and whether bodies meet there."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from jaxtyping import Float

from trinoc.geometry import Segments
from trinoc.match.line_map import Corners, JoinedLines
from trinoc.match.shadows.planes import Plane
from trinoc.match.tracks import Matches
from trinoc.match.tuning import ShadowTuning
from trinoc.numerics import ArrayLike, cross_3d

# Added to grey levels before their logarithm is taken: a black level tells little.
DARK_LEVEL = 4.0


def levels_beside(
    matches: Matches, segments: Mapping[str, Segments | ArrayLike], joined: JoinedLines
) -> Float[np.ndarray, "e v 2"]:
    """Logarithms of the darker and of the brighter level beside each line; NaN where not known."""
    found = np.full((len(joined), len(matches.views), 2), np.nan)
    for view, name in enumerate(matches.views):
        own = segments[name]
        levels = own.side_levels if isinstance(own, Segments) else None
        seen = np.flatnonzero(matches.index[:, view] >= 0)
        if levels is None or len(seen) == 0:
            continue
        pair = np.sort(np.asarray(levels)[matches.index[seen, view]], axis=1)
        good = np.isfinite(pair).all(axis=1)
        line, pair = joined.line_of_track[seen[good]], np.log(pair[good] + DARK_LEVEL)
        count = np.bincount(line, minlength=len(joined))
        for side in (0, 1):
            total = np.bincount(line, pair[:, side], minlength=len(joined))
            known = count > 0
            found[known, view, side] = total[known] / count[known]
    return found


def evidence_of_surroundings(
    joined: JoinedLines,
    corners: Corners,
    planes: list[Plane],
    levels: Float[np.ndarray, "e v 2"],
    tuning: ShadowTuning,
) -> Float[np.ndarray, "e 4"]:
    """For each line: whether it stands between two corners from which lines leave its plane,
    whether one of its ends is the corner of a body, how many lines of its plane have the same
    levels beside them (log of one more), and how much darker its one side is (log ratio)."""
    count = len(joined)
    step = joined.lines_mm[:, 1] - joined.lines_mm[:, 0]
    length = np.linalg.norm(step, axis=1)
    way = step / length[:, None]
    body, leaving = np.zeros((count, 2), dtype=bool), np.zeros((count, 2), dtype=bool)
    normal = np.zeros((count, 3))
    for plane in sorted(planes, key=_members):
        normal[plane.members] = plane.normal
    for corner in range(len(corners)):
        rows = np.flatnonzero(corners.corner == corner)
        for row in rows.tolist():
            line, end = corners.line[row], corners.end[row]
            others = corners.line[rows[rows != row]]
            leaving[line, end] = (np.abs(way[others] @ normal[line]) > tuning.leaving_sine).any()
            body[line, end] = any(
                abs(way[line] @ cross_3d(way[one], way[two])) > tuning.body_volume
                for one, two in combinations(others.tolist(), 2)
            )
    alike = np.zeros(count)
    for plane in planes:
        rows = np.flatnonzero(plane.members)
        apart = levels[rows, None] - levels[rows]
        known = np.isfinite(apart)
        number = known.sum(axis=(2, 3)) / 2
        square = np.where(known, (apart / tuning.level_sigma) ** 2, 0.0).sum(axis=(2, 3))
        same = np.where(number > 0, np.exp(-0.5 * square / np.maximum(number, 1)), 0.0)
        np.fill_diagonal(same, 0.0)
        share = np.minimum(length[rows] / np.median(length), 2.0)
        alike[rows] = np.maximum(alike[rows], same @ share)
    ratio = levels[:, :, 1] - levels[:, :, 0]
    known = np.isfinite(ratio)
    mean = np.where(known, ratio, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    # Nothing is known where no level is: as of a line like others.
    mean = np.where(known.any(axis=1), mean, tuning.usual_ratio)
    return np.stack(
        [leaving.all(axis=1), body.any(axis=1), np.log1p(alike), mean - tuning.usual_ratio], axis=1
    ).astype(np.float64)


def _members(plane: Plane) -> int:
    return int(plane.members.sum())
