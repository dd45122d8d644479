"""How far a line is shown by at least two of its views: further than by all of them."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry import homogeneous_pixel, project_by_matrix
from trinoc.match.observations import MatchInput, frames_of, matrices_of
from trinoc.numerics import take_groups


def two_view_span(reach: Float[np.ndarray, "t v 2"]) -> Float[np.ndarray, "t 2"]:
    """Where what at least two views show of each line begins and ends, given what each does."""
    # NaN, where a view does not see the line, sorts last.
    begin = np.sort(reach[..., 0], axis=1)[:, 1]
    return np.stack([begin, -np.sort(-reach[..., 1], axis=1)[:, 1]], axis=1)


def points_at(
    ends_mm: Float[np.ndarray, "t 2 3"], span: Float[np.ndarray, "t 2"]
) -> Float[np.ndarray, "t 2 3"]:
    """Points at two positions on each line, 0 and 1 at its ends."""
    return ends_mm[:, :1] + span[..., None] * (ends_mm[:, 1] - ends_mm[:, 0])[:, None]


def common_ends(
    seen: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Float[np.ndarray, "t 2 3"]:
    """The ends, on each line, of what all of its views show; the line's own where they share
    nothing."""
    reach = reach_of(seen, index, ends_mm)
    begin, end = np.nanmax(reach[..., 0], axis=1), np.nanmin(reach[..., 1], axis=1)
    shared = begin < end
    span = np.stack([np.where(shared, begin, 0.0), np.where(shared, end, 1.0)], axis=1)
    return points_at(ends_mm, span)


def interval_of(
    seen: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Float[np.ndarray, "t v 2"]:
    """Where the ends of each line lie along every segment, 0 at its first end.

    On segments that end before, this is outside [0, 1]: their lines run on.
    """
    interval, frame = np.zeros((*index.shape, 2)), frames_of(seen.lines, index)
    for view in range(index.shape[1]):
        on = np.flatnonzero(index[:, view] >= 0)
        matrix = matrices_of(seen.lines, take_groups(frame, on))[:, view]
        segment = seen.ends_px[view][index[on, view]]
        along = segment[:, 1] - segment[:, 0]
        offset = project_by_matrix(matrix, ends_mm[on]) - segment[:, :1]
        square = (along**2).sum(axis=1)[:, None]
        interval[on, view] = np.einsum("tei,ti->te", offset, along) / square
    return interval


def reach_of(
    seen: MatchInput, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Float[np.ndarray, "t v 2"]:
    """Where every segment begins and ends along its track's line, 0 and 1 at the line's ends."""
    reach, frame = np.full((*index.shape, 2), np.nan), frames_of(seen.lines, index)
    for view in range(index.shape[1]):
        on = np.flatnonzero(index[:, view] >= 0)
        segment = seen.ends_px[view][index[on, view]]
        matrix = matrices_of(seen.lines, take_groups(frame, on))[:, view]
        reach[on, view] = np.sort(positions_abreast(matrix, segment, ends_mm[on]), axis=1)
    return reach


def positions_abreast(
    matrix_px: Float[np.ndarray, "*t 3 4"],
    segment_px: Float[np.ndarray, "t 2 2"],
    ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 2"]:
    """Positions on each line, 0 and 1 at its ends, whose images lie abreast of a segment's ends."""
    first, last = np.moveaxis(homogeneous_pixel(matrix_px, ends_mm), 1, 0)
    step = last - first
    along = segment_px[:, 1] - segment_px[:, 0]
    place = np.einsum("tei,ti->te", segment_px, along)
    # The image at position s is (first + s step) / its depth: linear over linear.
    at_first, at_step = (first[:, :2] * along).sum(axis=1), (step[:, :2] * along).sum(axis=1)
    return (place * first[:, 2:] - at_first[:, None]) / (at_step[:, None] - place * step[:, 2:])


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
