"""Edges found where segments are already: which, and on which tracks."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry import project_by_matrix
from trinoc.match.guided.state import State
from trinoc.match.tuning import GuidedTuning

NONE = -1


class Known(NamedTuple):
    """Of each edge found in a view.

    segment : (n,) the segment that shows the same, or NONE.
    track : (n,) the track that shows the same part of this view, or NONE.
    """

    segment: Int[np.ndarray, "n"]
    track: Int[np.ndarray, "n"]


def known_in(
    state: State, view: int, ends_px: Float[np.ndarray, "n 2 2"], tuning: GuidedTuning
) -> Known:
    """What is known of edges found in a view."""
    segments = state.segments[view].ends_px
    shared = overlap_of(ends_px, segments, tuning.same_px)
    segment = _best(shared, tuning.same_overlap)
    on = np.flatnonzero(state.tracks.index[:, view] >= 0)
    image = project_by_matrix(state.cameras.matrix_px[view], state.tracks.ends_mm[on])
    parts = overlap_of(ends_px, image, tuning.same_px + 0.3)
    track = _best(parts, tuning.claimed_overlap)
    return Known(segment, np.where(track >= 0, on[track] if len(on) else NONE, NONE))


def overlap_of(
    ends_px: Float[np.ndarray, "n 2 2"], others_px: Float[np.ndarray, "m 2 2"], near_px: float
) -> Float[np.ndarray, "n m"]:
    """Share of the shorter that two segments have in common; 0 where they are not one line."""
    way = ends_px[:, 1] - ends_px[:, 0]
    length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    unit = way / length[:, None]
    off = others_px[None] - ends_px[:, None, :1]
    along = np.sort(np.einsum("nmei,ni->nme", off, unit), axis=2)
    across = np.einsum("nmei,ni->nme", off, np.stack([-unit[:, 1], unit[:, 0]], axis=1))
    raw = np.einsum("nmei,ni->nme", off, unit)
    step = raw[..., 1] - raw[..., 0]
    step = np.where(np.abs(step) > 1e-6, step, 1e-6)
    # The other line abreast of the ends of what both share.
    low = np.maximum(along[..., 0], 0.0)
    high = np.minimum(along[..., 1], length[:, None])
    slope = (across[..., 1] - across[..., 0]) / step
    at = [across[..., 0] + slope * (place - raw[..., 0]) for place in (low, high)]
    one = (high > low) & (np.abs(at[0]) < near_px) & (np.abs(at[1]) < near_px)
    size = np.minimum(length[:, None], along[..., 1] - along[..., 0])
    return np.where(one, (high - low) / np.maximum(size, 1e-9), 0.0)


def _best(shared: Float[np.ndarray, "n m"], least: float) -> Int[np.ndarray, "n"]:
    if shared.shape[1] == 0:
        return np.full(len(shared), NONE)
    best = shared.argmax(axis=1)
    return np.where(shared[np.arange(len(best)), best] >= least, best, NONE)
