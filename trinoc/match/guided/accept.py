"""New tracks: one after the other, the likeliest first, those that claim nothing that is taken."""

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.guided.attach import NONE, known_in
from trinoc.match.guided.corners import mm_per_px
from trinoc.match.guided.partners import Hypotheses
from trinoc.match.guided.proposals import Proposals
from trinoc.match.guided.state import State, Tracks, refitted, tables_of, with_segments
from trinoc.match.tracks import direction_doubt
from trinoc.match.tuning import GuidedTuning
from trinoc.numerics import concatenate_rows, take_rows


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
