"""Where a track can be: located by a pair of its views, and before its cameras.

Two views place a line where their interpretation planes cross. A segment nearly along its
epipolar line leaves the crossing open: how open, tells the error of its direction in the picture
over its angle to the epipolar line. Errors in space are inverse to that angle, so that their second
order counts where it is in doubt, and they have no covariance where it may be zero.
"""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.observations import SegmentTable, frames_of, matrices_of
from trinoc.numerics import take_groups


def direction_doubt(lines: SegmentTable, index: Int[np.ndarray, "t v"]) -> Float[np.ndarray, "t"]:
    """Standard deviation of a segment's direction over its angle to the epipolar line.

    The larger of the two segments of a pair of views, and the least of all pairs of a track.
    """
    least, frame = np.full(len(index), np.inf), frames_of(lines, index)
    for a, b in combinations(range(index.shape[1]), 2):
        on = np.flatnonzero((index[:, a] >= 0) & (index[:, b] >= 0))
        own = take_groups(frame, on)
        pair = np.maximum(
            _of_view(lines, a, b, index[on, a], own), _of_view(lines, b, a, index[on, b], own)
        )
        least[on] = np.minimum(least[on], pair)
    return least


def _of_view(
    lines: SegmentTable,
    view: int,
    other: int,
    segment: Int[np.ndarray, "n"],
    frame: Int[np.ndarray, "n"] | None,
) -> Float[np.ndarray, "n"]:
    ends = np.asarray(lines.ends_px)[view, segment]
    across = np.asarray(lines.across_px2)[view, segment]
    centre = np.asarray(lines.centre_mm)
    centre = centre[None, other] if frame is None else centre[frame, other]
    matrix = matrices_of(lines, frame)[:, view]
    epipole = (matrix[..., :3] @ centre[..., None])[..., 0] + matrix[..., 3]
    step, middle = ends[:, 1] - ends[:, 0], ends.mean(axis=1)
    # Toward the epipole, which may lie at infinity.
    toward = epipole[:, :2] - epipole[:, 2:] * middle
    area = step[:, 0] * toward[:, 1] - step[:, 1] * toward[:, 0]
    spread = np.sqrt(across[:, 0, 0] + across[:, 1, 1] - 2 * across[:, 0, 1])
    offset = np.abs(area) / np.linalg.norm(toward, axis=1)
    return spread / np.maximum(offset, 1e-12)


def before_cameras(
    lines: SegmentTable, index: Int[np.ndarray, "t v"], ends_mm: Float[np.ndarray, "t 2 3"]
) -> Bool[np.ndarray, "t"]:
    """Whether both ends, and so all between them, lie before every camera that sees the track."""
    matrix = matrices_of(lines, frames_of(lines, index))
    depth = matrix[..., 2, :3] @ ends_mm.mT + matrix[..., 2, 3:]
    return np.asarray(((depth > 0).all(axis=2) | (index < 0)).all(axis=1))
