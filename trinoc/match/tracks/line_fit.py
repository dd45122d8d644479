"""The line in space of each track: maximum likelihood of all of its segments."""

from functools import partial

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry import Segment3D, triangulate_segment
from trinoc.match.observations import MatchInput, frames_of
from trinoc.match.tracks.extent import interval_of, points_at, reach_of, two_view_span
from trinoc.match.tracks.fragments import ending_at, fragments_of
from trinoc.match.tracks.location import before_cameras
from trinoc.numerics import ArrayLike, in_blocks, kept_jit

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
