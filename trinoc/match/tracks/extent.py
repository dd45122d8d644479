"""How far a line is shown by at least two of its views: further than by all of them."""

import numpy as np
from jaxtyping import Float, Int

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
        offset = images_of(matrix, ends_mm[on]) - segment[:, :1]
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


def images_of(
    matrix_px: Float[np.ndarray, "*t 3 4"], points_mm: Float[np.ndarray, "t e 3"]
) -> Float[np.ndarray, "t e 2"]:
    """Undistorted pixels of points, by one matrix or by one for each row."""
    image = points_mm @ matrix_px[..., :3].mT + matrix_px[..., None, :, 3]
    return image[..., :2] / image[..., 2:]


def positions_abreast(
    matrix_px: Float[np.ndarray, "*t 3 4"],
    segment_px: Float[np.ndarray, "t 2 2"],
    ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 2"]:
    """Positions on each line, 0 and 1 at its ends, whose images lie abreast of a segment's ends."""
    turn = matrix_px[..., :3]
    first = np.einsum("...ij,...j->...i", turn, ends_mm[:, 0]) + matrix_px[..., 3]
    step = np.einsum("...ij,...j->...i", turn, ends_mm[:, 1] - ends_mm[:, 0])
    along = segment_px[:, 1] - segment_px[:, 0]
    place = np.einsum("tei,ti->te", segment_px, along)
    # The image at position s is (first + s step) / its depth: linear over linear.
    at_first, at_step = (first[:, :2] * along).sum(axis=1), (step[:, :2] * along).sum(axis=1)
    return (place * first[:, 2:] - at_first[:, None]) / (at_step[:, None] - place * step[:, 2:])
