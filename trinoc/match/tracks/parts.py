"""Parts of one line: what all of its segments show, and how much of a segment two parts share."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry import project_by_matrix
from trinoc.match.observations import MatchInput
from trinoc.match.tracks.extent import reach_of


def common_part(
    seen: MatchInput, index: Int[np.ndarray, "v"], near_mm: Float[np.ndarray, "2 3"]
) -> Float[np.ndarray, "2 3"] | None:
    """Ends, on a line through two points, of what all of its segments show; None where nothing."""
    reach = reach_of(seen, index[None], near_mm[None])[0]
    begin, end = np.nanmax(reach[:, 0]), np.nanmin(reach[:, 1])
    if not begin < end:
        return None
    return near_mm[0] + np.array([[begin], [end]]) * (near_mm[1] - near_mm[0])


def overlap(
    seen: MatchInput,
    view: int,
    segment: int,
    one_mm: Float[np.ndarray, "2 3"],
    other_mm: Float[np.ndarray, "2 3"],
) -> float:
    """Common length of two parts on a segment as a share of the shorter."""
    ends = seen.ends_px[view][segment]
    way = ends[1] - ends[0]
    matrix = np.asarray(seen.lines.matrix_px)[view]
    one, other = (
        np.sort((project_by_matrix(matrix, part) - ends[0]) @ way) for part in (one_mm, other_mm)
    )
    common = min(one[1], other[1]) - max(one[0], other[0])
    return float(common / min(np.ptp(one), np.ptp(other)))
