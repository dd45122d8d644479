"""The line in space of each track: maximum likelihood of all of its segments, tested as a whole.

Triples that share segments two by two chain to tracks whose ends no longer agree. So the whole
track is tested, and what does not fit is split off, the worst first.

Two views place a line where their interpretation planes cross. A segment nearly along its
epipolar line leaves the crossing open: how open, tells the error of its direction in the picture
over its angle to the epipolar line. Errors in space are inverse to that angle, so that their second
order counts where it is in doubt, and they have no covariance where it may be zero.
"""

from functools import partial
from itertools import combinations
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry import Segment3D, triangulate_segment
from trinoc.match.observations import MatchInput, SegmentTable, frames_of, matrices_of
from trinoc.match.tracks.extent import interval_of, points_at, reach_of, two_view_span
from trinoc.match.tracks.fragments import ending_at, fragments_of
from trinoc.numerics import (
    ArrayLike,
    chi_square_limit,
    chi_square_tail,
    in_blocks,
    kept_jit,
    take_groups,
)


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


# Few enough for a processor's cache.
MOST_AT_ONCE = 1 << 10


@partial(kept_jit, beside_others=True)
def _triangulated(
    matrix_px: Float[ArrayLike, "*f v 3 4"],
    frame: Int[ArrayLike, "t"] | None,
    fragments_px: Float[ArrayLike, "t v 2 2"],
    covariance_px2: Float[ArrayLike, "t v 4 4"],
    shown: Bool[ArrayLike, "t v"],
) -> Segment3D:
    matrix = matrix_px if frame is None else matrix_px[frame]
    each = jax.vmap(triangulate_segment, in_axes=(None if frame is None else 0, 0, 0, 0))
    return each(matrix, fragments_px, covariance_px2, shown)


def lines_in_space(
    seen: MatchInput,
    index: Int[np.ndarray, "t v"],
    common_mm: Float[np.ndarray, "t 2 3"],
    reach: Float[np.ndarray, "t v 2"] | None = None,
) -> tuple[Float[np.ndarray, "t 2 3"], Float[np.ndarray, "t 6 6"], Float[np.ndarray, "t"]]:
    """Maximum-likelihood ends of what two views show, with covariance and chi-square.

    `common_mm` are the ends of the part that all views of a track show, `reach` what `reach_of`
    says of them, if at hand.
    """
    reach = reach_of(seen, index, common_mm) if reach is None else reach
    span = two_view_span(reach)
    # Beyond the common part a line may pass behind a camera that sees it.
    before = before_cameras(seen.lines, index, points_at(common_mm, span))
    span = np.where(before[:, None], span, np.array([0.0, 1.0]))
    part_mm, ends_here = points_at(common_mm, span), ending_at(reach, span)
    shown = fragments_of(seen, index, interval_of(seen, index, part_mm), ends_here)
    # Rows of padding hold no view, which leaves their lines undetermined, and harmless.
    block, frame = min(seen.lines.ends_px.shape[1], MOST_AT_ONCE), frames_of(seen.lines, index)

    def triangulated(
        fragments: np.ndarray, covariance: np.ndarray, members: np.ndarray, *frames: np.ndarray
    ) -> Segment3D:
        own = frames[0] if frames else None
        return _triangulated(seen.lines.matrix_px, own, fragments, covariance, members)

    frames = () if frame is None else (frame,)
    found = in_blocks(triangulated, block, *shown, index >= 0, *frames)
    misfit = np.where((index >= 0).sum(axis=1) > 2, found.chi_square, 0.0)
    return np.asarray(found.ends_mm), np.asarray(found.covariance_mm2), misfit


class FittedTracks(NamedTuple):
    """Tracks with their lines: segments of each view, common part, ends, covariance, misfit."""

    index: Int[np.ndarray, "t v"]
    common_mm: Float[np.ndarray, "t 2 3"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    misfit: Float[np.ndarray, "t"]


def fit_tracks(
    seen: MatchInput, index: Int[np.ndarray, "t v"], common_mm: Float[np.ndarray, "t 2 3"]
) -> FittedTracks:
    """The lines of these tracks."""
    return FittedTracks(index, common_mm, *lines_in_space(seen, index, common_mm))


def consistent(tracks: FittedTracks, gate: float) -> Bool[np.ndarray, "t"]:
    """Whether tracks misfit no more than as likely as a triple passes the gate (chi-square of 2
    degrees of freedom)."""
    degrees = 2 * ((tracks.index >= 0).sum(axis=1) - 2)
    limit = chi_square_limit(chi_square_tail(gate, 2), np.maximum(degrees, 1))
    return (tracks.misfit <= np.where(degrees > 0, limit, np.inf)) & np.isfinite(tracks.misfit)


def split_off_misfits(seen: MatchInput, tracks: FittedTracks, gate: float) -> FittedTracks:
    """Tracks that are consistent, or made so by leaving out the views that fit worst; rows of
    those that even three views do not agree on hold no view."""
    index = tracks.index.copy()
    now = tracks
    while True:
        bad = np.flatnonzero(~consistent(now, gate))
        views = (index[bad] >= 0).sum(axis=1)
        index[bad[views <= 3]] = -1
        bad = bad[views > 3]
        if len(bad) == 0:
            return now._replace(index=index)
        owner, view = np.nonzero(index[bad] >= 0)
        trial = index[bad][owner]
        trial[np.arange(len(owner)), view] = -1
        misfit = np.nan_to_num(
            fit_tracks(seen, trial, now.common_mm[bad][owner]).misfit, nan=np.inf
        )
        best = np.lexsort((misfit, owner))
        best = best[np.unique(owner[best], return_index=True)[1]]
        index[bad] = trial[best]
        again = fit_tracks(seen, index[bad], now.common_mm[bad])
        columns = [column.copy() for column in now]
        for column, new in zip(columns, again, strict=True):
            column[bad] = new
        now = FittedTracks(*columns)
