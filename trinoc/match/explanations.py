"""Possible mistakes in a set of segments, each with the corrected set, to be matched again.

Images may be exchanged, turned, of another size than the rig states, or shifted. The shift is
estimated. Two other views predict the ends of lines in the image. The most frequent difference
between these and the ends of parallel segments is the shift.
"""

from collections.abc import Callable, Iterator
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.geometry.projection import project_by_matrix
from trinoc.match import sentences
from trinoc.match.observations.match_input import FrameInput, order_ends
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.tracks import DecoyTuning

# numerical: matrices that reverse u, reverse v, or turn by 180 degrees, about the image's middle.
MIRRORED, UPSIDE_DOWN, TURNED = (np.diag(signs) for signs in ((-1.0, 1), (1, -1.0), (-1.0, -1.0)))
SAME = np.eye(2)  # numerical: no change.

# numerical: a shift is not estimated from fewer residuals.
MIN_RESIDUALS = 8


class Mistake(NamedTuple):
    """A possible mistake in the input: its description, and the frame after its correction."""

    description: str
    corrected: FrameInput


def undo_mistakes(frame: FrameInput) -> Iterator[Iterator[Mistake]]:
    """Yield groups of possible mistakes: exchanged, turned and resized images, in this sequence.

    The groups are sorted by frequency in practice, the most frequent group first.
    """
    yield _exchange_views(frame)
    yield _turn_views(frame)
    yield _resize_views(frame)


def _exchange_views(frame: FrameInput) -> Iterator[Mistake]:
    for order in permutations(range(3)):
        exchanged = [k for k in range(3) if order[k] != k]
        if exchanged:
            cameras = frame.cameras.take(list(order))
            description = sentences.images_exchanged(frame.names[k] for k in exchanged)
            yield Mistake(description, frame._replace(cameras=cameras))


def _turn_views(frame: FrameInput) -> Iterator[Mistake]:
    for view, name in enumerate(frame.names):
        for change, adjective in ((TURNED, "upside down"), (MIRRORED, "mirrored")):
            description = sentences.image_turned(name, adjective)
            yield Mistake(description, change_view(frame, view, change))


def _resize_views(frame: FrameInput) -> Iterator[Mistake]:
    """Yield possible mistakes: images with half or twice the size that the rig states.

    First one image with the wrong size, for each view; then all images with the wrong size.
    """
    for scale, size in ((2.0, "half"), (0.5, "twice")):
        all_resized = frame
        for view in range(len(frame.names)):
            # The fixed point is the corner of the image, half a pixel before the first centre.
            corner = (scale - 1) * np.asarray(frame.cameras.size_px[view]) / 2
            all_resized = change_view(all_resized, view, scale * SAME, corner)
            one_resized = change_view(frame, view, scale * SAME, corner)
            yield Mistake(sentences.image_resized(frame.names[view], size), one_resized)
        yield Mistake(sentences.all_images_resized(size), all_resized)


def seems_shifted(frame: FrameInput, index: Int[np.ndarray, "t 3"], tuning: DecoyTuning) -> bool:
    """True if a shift of one image explains most residuals of that image.

    A residual is the distance of a segment's midpoint from the line that the two other views
    predict. A shift s of the image changes this distance by n . s, with n the unit normal of the
    line. `index` (t, 3) are the segments of the tracks.
    """
    if len(index) < MIN_RESIDUALS:
        return False
    for view in range(3):
        normal, offset_px = _transfer(frame, index, view)
        shift, weight = np.zeros(2), np.ones(len(offset_px))
        for _ in range(tuning.shift_rounds):
            weighted = normal.T * weight
            shift = np.linalg.lstsq(weighted @ normal, weighted @ offset_px, rcond=None)[0]
            residual = np.abs(offset_px - normal @ shift)
            weight = 1 / (1 + (residual / max(np.median(residual), 1e-9)) ** 2)
        median_before, median_after = (
            np.median(np.abs(offset_px - normal @ s)) for s in (np.zeros(2), shift)
        )
        if (
            np.linalg.norm(shift) > tuning.min_shift_px
            and median_after < tuning.quieter_share * median_before
        ):
            return True
    return False


def _transfer(
    frame: FrameInput, index: Int[np.ndarray, "t 3"], view: int
) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, "t"]]:
    """Predict the line of each track in one view from its segments in the two other views.

    Returns the unit normals of the lines (t, 2), and the signed distances of the segments'
    midpoints from the lines (t,), px.
    """
    planes = []
    for other in {0, 1, 2} - {view}:
        ends = np.pad(
            frame.ends_px[other][index[:, other]], ((0, 0), (0, 0), (0, 1)), constant_values=1.0
        )
        planes.append(np.cross(ends[:, 0], ends[:, 1]) @ frame.cameras.matrix_px[other])
    matrix, centre = frame.cameras.matrix_px[view], np.append(frame.cameras.centre_mm[view], 1.0)
    # Both planes contain the line. The plane of their pencil through this camera's centre gives
    # the image of the line.
    first, second = planes
    plane = (second @ centre)[:, None] * first - (first @ centre)[:, None] * second
    line = np.linalg.solve(matrix[:, :3].T, plane[:, :3].T).T
    line = line / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    middle = frame.ends_px[view][index[:, view]].mean(axis=1)
    return line[:, :2], (line[:, :2] * middle).sum(axis=1) + line[:, 2]


def find_shifts(
    frame: FrameInput, match: Callable[[FrameInput], Matches], tuning: DecoyTuning
) -> Iterator[Mistake]:
    """Yield the mistake of a shifted image, for each view whose estimated shift is large enough.

    The shift is the difference between the view's segments and the lines that the two other views
    predict.
    """
    for pair in combinations(range(3), 2):
        view = 3 - sum(pair)
        lines_mm = match(take_views(frame, list(pair))).lines_mm
        expected_px = project_by_matrix(frame.cameras.matrix_px[view], lines_mm)
        shift = estimate_shift(expected_px, frame.ends_px[view], tuning)
        if shift is not None and np.hypot(*shift) > tuning.min_shift_px:
            description = sentences.image_shifted(frame.names[view], shift)
            yield Mistake(description, change_view(frame, view, SAME, -shift))


def estimate_shift(
    expected_px: Float[np.ndarray, "t 2 2"],
    segments_px: Float[np.ndarray, "n 2 2"],
    tuning: DecoyTuning,
) -> Float[np.ndarray, "2"] | None:
    """Return the most frequent offset between segments and parallel predicted segments, (2,) px.

    The result is None if no segment is parallel to a predicted segment nearby.
    """
    expected_step, segment_step = (
        np.diff(ends, axis=1)[:, 0] for ends in (expected_px, segments_px)
    )
    length_products = np.outer(
        *(np.linalg.norm(vector, axis=1) for vector in (expected_step, segment_step))
    )
    area = expected_step[:, :1] * segment_step[:, 1] - expected_step[:, 1:] * segment_step[:, 0]
    is_parallel = np.abs(area) < np.sin(np.radians(tuning.parallel_deg)) * length_products
    i, j = np.nonzero(is_parallel)
    ends = np.where(
        (expected_step[i] * segment_step[j]).sum(axis=1)[:, None, None] < 0,
        segments_px[j, ::-1],
        segments_px[j],
    )
    offset_px = (ends - expected_px[i]).reshape(-1, 2)
    offset_px = offset_px[(np.abs(offset_px) < tuning.shift_range_px).all(axis=1)]
    if len(offset_px) == 0:
        return None
    tree = KDTree(offset_px)
    neighbours = tree.query_ball_point(offset_px, tuning.shift_tolerance_px, return_length=True)
    shift = offset_px[np.argmax(neighbours)]
    for _ in range(tuning.shift_rounds):
        shift = np.median(
            offset_px[tree.query_ball_point(shift, tuning.shift_tolerance_px)], axis=0
        )
    return shift


def change_view(
    frame: FrameInput,
    view: int,
    change: Float[np.ndarray, "2 2"],
    shift_px: Float[np.ndarray, "2"] | float = 0.0,
) -> FrameInput:
    """Return the frame with the segments of one view transformed.

    The transformation is the linear map `change` about the image's midpoint, followed by the shift
    `shift_px`.
    """
    middle = (np.asarray(frame.cameras.size_px[view]) - 1) / 2
    ends = (frame.ends_px[view] - middle) @ change.T + middle + shift_px
    change_of_ends = np.kron(np.eye(2), change)
    # Tables need ends from left to right, and segments sorted by position.
    ends, covariance, swap = order_ends(
        ends, change_of_ends @ frame.covariance_px2[view] @ change_of_ends.T
    )
    # Exchanged ends reverse the darker side, and so does a mirrored image.
    sides_exchanged = swap ^ (np.linalg.det(change) < 0)
    polarity = np.where(sides_exchanged, -1, 1) * frame.polarity[view]
    sides = np.where(
        sides_exchanged[:, None], frame.sides[view][:, [1, 0, 3, 2, 4, 5, 6]], frame.sides[view]
    )
    new_columns = {
        "ends_px": ends,
        "covariance_px2": covariance,
        "polarity": polarity,
        "sides": sides,
    }
    columns = {
        name: [new if k == view else column for k, column in enumerate(getattr(frame, name))]
        for name, new in new_columns.items()
    }
    rows = [np.arange(len(order)) for order in frame.order]
    rows[view] = np.lexsort(ends.reshape(-1, 4).T[::-1])
    return _take_segments(frame._replace(**columns), rows)


def take_longest(frame: FrameInput, limit: int) -> FrameInput:
    """Return the frame with only the `limit` longest segments of each view.

    Long segments are most often visible in all views.
    """
    length = [np.linalg.norm(np.diff(ends, axis=1)[:, 0], axis=1) for ends in frame.ends_px]
    rows = [
        np.sort(np.argsort(-length_of_view, kind="stable")[:limit]) for length_of_view in length
    ]
    # The sample has its own numbering, since its result is only counted.
    order = [np.arange(len(row)) for row in rows]
    exclusion_reasons = [np.full(len(row), "") for row in rows]
    return _take_segments(frame, rows)._replace(order=order, exclusion_reasons=exclusion_reasons)


def _take_segments(frame: FrameInput, rows: list[Int[np.ndarray, "_"]]) -> FrameInput:
    """Return the frame with only the segments of the given indices, `rows[view]` in each view."""
    columns = {
        name: [column[of_view] for column, of_view in zip(getattr(frame, name), rows, strict=True)]
        for name in ("order", "ends_px", "covariance_px2", "polarity", "sides")
    }
    return frame._replace(**columns)


def take_views(frame: FrameInput, views: list[int]) -> FrameInput:
    """Return the frame with only the views of the given indices."""
    columns = {
        name: [column[view] for view in views]
        for name, column in frame._asdict().items()
        if isinstance(column, list)
    }
    names = tuple(frame.names[view] for view in views)
    return frame._replace(names=names, cameras=frame.cameras.take(views), **columns)
