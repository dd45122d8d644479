"""New tracks: one after the other, the likeliest first, those that claim nothing that is taken."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry import project_by_matrix
from trinoc.match.pixels.joint import Proposals
from trinoc.match.pixels.partners import Hypotheses, mm_per_px
from trinoc.match.pixels.state import State, Tracks, refitted, tables_of, with_segments
from trinoc.match.tracks import direction_doubt
from trinoc.match.tuning import GuidedTuning
from trinoc.numerics import concatenate_rows, take_rows

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


def with_accepted(state: State, proposals: Proposals, tuning: GuidedTuning) -> tuple[State, int]:
    """(the state with new tracks, how many)."""
    free = take_rows(proposals, ~_claimed(state, proposals, tuning))
    count = 0
    for row in range(len(free.log_odds)):
        one = take_rows(free, np.array([row]))
        # What was added just now is taken, too.
        if count and _claimed(state, one, tuning).any():
            continue
        grown, new = _tried(state, one, tuning)
        if new.misfit[0] > tuning.gate or not _as_asked(grown, new, one.asked_for, tuning):
            continue
        state = grown._replace(tracks=concatenate_rows([state.tracks, new]))
        count += 1
    return state, count


def _claimed(state: State, proposals: Proposals, tuning: GuidedTuning) -> Bool[np.ndarray, "n"]:
    """Whether a track shows any of a line's edges already."""
    claimed = np.zeros(len(proposals.log_odds), dtype=bool)
    for view, answer in enumerate(proposals.answers):
        on = np.flatnonzero(proposals.members[:, view])
        claimed[on] |= known_in(state, view, answer.ends_px[on], tuning).track >= 0
    return claimed


def _tried(state: State, one: Proposals, tuning: GuidedTuning) -> tuple[State, Tracks]:
    """(the segments with the edges of one line, its track)."""
    index = np.full((1, one.members.shape[1]), NONE)
    for view in np.flatnonzero(one.members[0]).tolist():
        answer = one.answers[view]
        index[0, view] = known_in(state, view, answer.ends_px, tuning).segment[0]
        if index[0, view] == NONE:
            index[0, view] = len(state.segments[view].ends_px)
            contrast = answer.sign * answer.contrast
            state = with_segments(state, view, answer.ends_px, answer.covariance_px2, contrast)
    track = _unlocated(index, one.log_odds, one.asked_for.ends_mm)
    return state, refitted(state._replace(tracks=track), track).tracks


def _unlocated(
    index: Int[np.ndarray, "1 v"],
    log_odds: Float[np.ndarray, "1"],
    line_mm: Float[np.ndarray, "1 2 3"],
) -> Tracks:
    """A track whose line is where it was asked for."""
    unknown = np.zeros((1, 6, 6)), np.zeros(1), np.zeros((*index.shape, 2))
    return Tracks(index, log_odds, line_mm, *unknown)


def _as_asked(state: State, new: Tracks, asked_for: Hypotheses, tuning: GuidedTuning) -> bool:
    """Whether its views locate a new line, and where it was asked for: near its line, and from
    about a corner on."""
    doubt = direction_doubt(tables_of(state).lines, new.index)
    if not np.isfinite(new.ends_mm).all() or doubt[0] >= tuning.largest_doubt:
        return False
    begin, end = asked_for.ends_mm[0]
    length = np.linalg.norm(end - begin)
    unit = (end - begin) / length
    along = (new.ends_mm[0] - begin) @ unit
    across = np.linalg.norm(new.ends_mm[0] - begin - along[:, None] * unit, axis=1)
    gap = along.min()
    if asked_for.ends_in_corner[0]:
        gap = min(gap, length - along.max())
    near = across < tuning.as_asked_px * mm_per_px(state, new.ends_mm[0])
    return bool(near.all() and gap < tuning.corner_gap * length)
