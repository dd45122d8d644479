"""Tracks of matchers that give every 3-D line a set of segments, several per view."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.evaluation.scoring import Group
from trinoc.numerics import ArrayLike

# A chance touch of two supports on one line is no claim that they match.
_LEAST_COMMON_SHARE = 0.1


def groups_of_supports(
    lines_mm: Float[np.ndarray, "t 2 3"],
    supports: Sequence[Mapping[int, Sequence[int]]],
    endpoints_px: Sequence[Float[ArrayLike, "_ 2 2"]],
    matrices_px: Float[np.ndarray, "v 3 4"],
) -> set[Group]:
    """The pairs and triples of segments that lines in space claim, for `score_groups`.

    `supports` holds, per line, the segments of each view's number. Supports of several views
    are claimed to match where the parts of the line that they image (nearest points of their
    ends' viewing rays) share more than a tenth of the shortest.
    """
    groups: set[Group] = set()
    for line, by_view in zip(lines_mm, supports, strict=True):
        members = {
            view: [
                ((view, int(i)), part_of_line(line, endpoints_px[view][i], matrices_px[view]))
                for i in chosen
            ]
            for view, chosen in sorted(by_view.items())
        }
        for size in (2, 3):
            for views in itertools.combinations(members, size):
                for chosen in itertools.product(*(members[view] for view in views)):
                    low, high = np.array([part for _, part in chosen]).T
                    if high.min() - low.max() > _LEAST_COMMON_SHARE * (high - low).min():
                        groups.add(tuple(member for member, _ in chosen))
    return groups


def part_of_line(
    line_mm: Float[np.ndarray, "2 3"],
    endpoints_px: Float[ArrayLike, "2 2"],
    matrix_px: Float[np.ndarray, "3 4"],
) -> Float[np.ndarray, "2"]:
    """Positions, ascending, along a line (0 its first end, 1 its second) nearest to the
    viewing rays of a segment's ends."""
    left = matrix_px[:, :3]
    centre = -np.linalg.solve(left, matrix_px[:, 3])
    along = line_mm[1] - line_mm[0]
    positions = []
    for uv in np.asarray(endpoints_px):
        ray = np.linalg.solve(left, np.append(uv, 1.0))
        normal = np.cross(ray, np.cross(along, ray))
        positions.append(normal @ (centre - line_mm[0]) / (normal @ along))
    return np.sort(positions)
