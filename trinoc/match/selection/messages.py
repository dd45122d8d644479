"""Marginals under mutual exclusion, by sum-product belief propagation.

Each part of a segment belongs to at most one line, which defines the conflicts between
candidates. On the factor graph of these conflicts, the message from a segment to a candidate is
-log(1 + sum of the rivals' cavity odds). The posterior log odds of a candidate are its prior log
odds plus its messages. The marginals are used instead of the MAP assignment, because MAP may
replace one strong triple by two weak ones, and hides ambiguity. Candidates without rivals
receive no message.
"""

from bisect import bisect_left
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.selection import SelectionTuning
from trinoc.numerics.buckets import bucket, pad_rows
from trinoc.numerics.joins import expand_ranges, pairs_of_equal_keys
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit


class ConflictGraph(NamedTuple):
    """Ordered pairs of rivals: candidates that use the same part of a segment.

    A slot is a candidate and a view, encoded as candidate * views + view. The pairs are sorted by
    `slot`.

    Attributes
    ----------
    slot : (e,)
        Candidate that receives the message of its rival, and the view of the common segment.
    rival_slot : (e,)
        The rival, and the same view.
    views : int
        Number of views.
    """

    slot: Int[np.ndarray, "e"]
    rival_slot: Int[np.ndarray, "e"]
    views: int


def conflict_graph(
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: SelectionTuning = DEFAULT.selection,
) -> ConflictGraph:
    """List the pairs of candidates that use the same part of a segment.

    Two candidates with several common parts are listed for the first such view only. `index` is -1
    in views without a segment.
    """
    views = index.shape[1]
    # Sorted bounds of the interval on each segment.
    low, high = interval.min(axis=2), interval.max(axis=2)

    def overlaps(m: Int[np.ndarray, "e"], n: Int[np.ndarray, "e"], view: int) -> np.ndarray:
        bounds = low[m, view], high[m, view], low[n, view], high[n, view]
        return _overlap(*bounds, tuning.conflict_overlap)

    slots, rival_slots = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
    for view in range(views):
        members = np.flatnonzero(index[:, view] >= 0)
        for m, n in pairs_of_equal_keys(index[members, view]):
            m, n = members[m], members[n]
            is_conflict = overlaps(m, n, view)
            m, n = m[is_conflict], n[is_conflict]
            for earlier in range(view):
                share_earlier = (index[m, earlier] == index[n, earlier]) & (index[m, earlier] >= 0)
                is_counted = share_earlier & overlaps(m, n, earlier)
                m, n = m[~is_counted], n[~is_counted]
            m, n = ((x * views + view).astype(np.int32) for x in (m, n))
            slots += [m, n]
            rival_slots += [n, m]
    # One number holds both slots: sorting it is several times faster than an argsort.
    edges = np.concatenate(slots).astype(np.int64) << 32
    edges |= np.concatenate(rival_slots)
    edges.sort()
    return ConflictGraph((edges >> 32).astype(np.int32), edges.astype(np.int32), views)


def rows_within_memory(
    log_odds: Float[np.ndarray, "m"],
    index: Int[np.ndarray, "m v"],
    above: float,
    tuning: SelectionTuning = DEFAULT.selection,
) -> Int[np.ndarray, "k"]:
    """Return the indices of the candidates whose log odds exceed `above`, (k,).

    If these candidates have more conflicts than the memory allows, only the most likely ones are
    returned.
    """
    selected_rows = np.flatnonzero(log_odds > above)
    log_odds, index = log_odds[selected_rows], index[selected_rows]

    def conflicts(threshold: float) -> int:
        rows = index[log_odds >= threshold]
        counts = (np.bincount(rows[rows[:, view] >= 0, view]) for view in range(index.shape[1]))
        return sum(int((count**2).sum()) for count in counts)

    threshold = -np.inf
    if conflicts(threshold) > tuning.max_conflicts:
        # Candidates with equal log odds are kept or discarded together.
        ordered = np.append(np.unique(log_odds), np.inf)
        position = bisect_left(
            ordered, True, key=lambda odds: conflicts(odds) <= tuning.max_conflicts
        )
        threshold = ordered[position]
    return selected_rows[log_odds >= threshold]


def log_kept_share(
    log_odds: Float[np.ndarray, "m"],
    index: Int[np.ndarray, "m v"],
    selected_rows: Int[np.ndarray, "k"],
) -> Float[np.ndarray, "k"]:
    """Log of the probability that the right candidate was not discarded, for each selected one,
    (k,).

    Candidates are discarded to limit the memory. For a segment, the probability is the odds of its
    selected candidates over the odds of all its candidates. For a candidate, the result is the
    smallest value of its segments.
    """
    share = np.zeros(len(selected_rows))
    for view in range(index.shape[1]):
        segment = index[:, view]
        rows = np.flatnonzero(segment >= 0)
        count = int(segment.max(initial=-1)) + 1
        # The alternative that no candidate is right has odds of 1.
        largest = np.zeros(count)
        np.maximum.at(largest, segment[rows], log_odds[rows])
        odds = np.zeros(len(segment))
        odds[rows] = np.exp(log_odds[rows] - largest[segment[rows]])
        odds_of_none = np.exp(-largest)
        selected_in_view = selected_rows[segment[selected_rows] >= 0]
        all_odds = np.bincount(segment[rows], odds[rows], count) + odds_of_none
        selected_odds = (
            np.bincount(segment[selected_in_view], odds[selected_in_view], count) + odds_of_none
        )
        selected_segment = np.where(segment[selected_rows] >= 0, segment[selected_rows], 0)
        log_share = np.log(selected_odds / all_odds)[selected_segment] if count else share
        share = np.minimum(share, np.where(segment[selected_rows] >= 0, log_share, 0.0))
    return share


def with_log_share(
    log_odds: Float[np.ndarray, "m"], log_share: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m"]:
    """Return the log odds of the probability p s.

    `log_odds` are the log odds of p, and `log_share` is the logarithm of s.
    """
    # log(p s / (1 - p s)) with p = 1 / (1 + exp(-x)).
    lacking = np.expm1(-log_share)
    return -np.logaddexp(-log_odds - log_share, np.log(np.maximum(lacking, 1e-300)))


def use_claimed_parts(
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    claimed_index: Int[np.ndarray, "t v"],
    claimed_interval: Float[np.ndarray, "t v 2"],
    tuning: SelectionTuning = DEFAULT.selection,
) -> Bool[np.ndarray, "m"]:
    """Return the mask of the candidates that use a part of a segment of a given track, (m,).

    `claimed_index` and `claimed_interval` are the segments of the tracks, and their parts.
    """
    is_claimed = np.zeros(len(index), dtype=bool)
    for view in range(index.shape[1]):
        owners = np.argsort(claimed_index[:, view], kind="stable")
        segments = claimed_index[owners, view]
        members = np.flatnonzero(index[:, view] >= 0)
        m, position = expand_ranges(
            np.searchsorted(segments, index[members, view], "left"),
            np.searchsorted(segments, index[members, view], "right"),
        )
        m, claimant = members[m], owners[position]
        part, claimed_part = interval[m, view], claimed_interval[claimant, view]
        bounds = (
            part.min(axis=1),
            part.max(axis=1),
            claimed_part.min(axis=1),
            claimed_part.max(axis=1),
        )
        is_conflict = _overlap(*bounds, tuning.conflict_overlap)
        is_claimed[m[is_conflict]] = True
    return is_claimed


def _overlap(
    low: Float[np.ndarray, "e"],
    high: Float[np.ndarray, "e"],
    other_low: Float[np.ndarray, "e"],
    other_high: Float[np.ndarray, "e"],
    least_share: float,
) -> Bool[np.ndarray, "e"]:
    shared = np.minimum(high, other_high) - np.maximum(low, other_low)
    return shared > least_share * np.minimum(high - low, other_high - other_low)


# numerical: largest number of frames in one problem.
FRAMES_AT_ONCE = 64

# numerical: above this number of conflicts, padding has more sizes: its rounds would take longer
# than compiling another program.
_FINER_ABOVE = 1 << 16
# numerical: up to this number of conflicts and 2048 candidates, padding has few sizes. Larger
# problems have at least _MIN_PADDED candidates.
_FEW_CONFLICTS = 1 << 14
_MIN_PADDED = 1 << 12  # numerical: as above
# numerical: largest log odds with a finite exponential, and the log odds of padding.
_MAX_LOG_ODDS, _MIN_LOG_ODDS = 60.0, -1e4


class _Iteration(NamedTuple):
    damping: Float[ArrayLike, ""] | float
    tolerance: Float[ArrayLike, ""] | float
    iterations: Int[ArrayLike, ""] | int


# Messages (candidates, views), mask of the frames that have not converged, remaining rounds.
_State = tuple[Float[ArrayLike, "m v"], Bool[ArrayLike, "f"], Int[ArrayLike, ""]]


class Beliefs(NamedTuple):
    """Result of belief propagation.

    Attributes
    ----------
    log_odds : (m,)
        Posterior log odds of each candidate.
    messages : (m, v)
        Message from the segment of each view to the candidate.
    """

    log_odds: Float[np.ndarray, "m"]
    messages: Float[np.ndarray, "m v"]


def sum_product(
    log_odds: Float[np.ndarray, "m"],
    graph: ConflictGraph,
    tuning: SelectionTuning = DEFAULT.selection,
    frame: Int[np.ndarray, "m"] | None = None,
    previous: Beliefs | None = None,
) -> Beliefs:
    """Compute posterior log odds under mutual exclusion, by sum-product belief propagation.

    The messages are iterated to their fixed point, in each frame until it converges.

    Parameters
    ----------
    log_odds : (m,)
        Log odds before the exclusion of rivals.
    graph : ConflictGraph
        Pairs of rivals.
    tuning : SelectionTuning
        Tuned constants.
    frame : (m,), optional
        Frame of each candidate, below FRAMES_AT_ONCE.
    previous : Beliefs, optional
        Initial messages. Default: the messages that result if only the candidates accepted by
        `choose_greedily` are right.
    """
    count = len(log_odds)
    if len(graph.slot) == 0:
        return Beliefs(log_odds, np.zeros((count, graph.views)))
    has_rival = np.zeros(count, dtype=bool)
    has_rival[graph.slot // graph.views] = True
    rows, new_index = np.flatnonzero(has_rival), np.cumsum(has_rival) - 1
    candidates, conflicts = _padded_sizes(len(rows) + 1, len(graph.slot))
    # All conflicts of padding connect the last slots, which belong to a candidate of padding.
    padding_slot = candidates * graph.views - 1
    slot, rival_slot = (
        pad_rows(_renumber_slots(slots, new_index, graph.views), conflicts, padding_slot)
        for slots in (graph.slot, graph.rival_slot)
    )
    messages = np.zeros((count, graph.views))
    start_messages = messages if previous is None else previous.messages
    is_selected = (
        choose_greedily(log_odds, graph) if previous is None else np.zeros(count, dtype=bool)
    )
    final_messages = _propagate(
        pad_rows(log_odds[rows], candidates, _MIN_LOG_ODDS),
        pad_rows(is_selected[rows], candidates, False),
        pad_rows(start_messages[rows], candidates),
        np.asarray(previous is None),
        slot,
        rival_slot,
        pad_rows(label_frames(frame, count)[rows], candidates),
        _Iteration(tuning.damping, tuning.tolerance, tuning.iterations),
        graph.views,
    )
    messages[rows] = np.asarray(final_messages)[: len(rows)]
    return Beliefs(log_odds + messages.sum(axis=1), messages)


def _padded_sizes(candidates: int, conflicts: int) -> tuple[int, int]:
    """Return the numbers of candidates and of conflicts after padding.

    Small problems use only a few sizes, because compiling another program takes as long as hundreds
    of rounds on padding.
    """
    small_size = next((size for size in (256, 2048) if candidates <= size), None)
    if small_size is None or conflicts > _FEW_CONFLICTS:
        pairs = bucket(conflicts, smallest=2 * _FEW_CONFLICTS, finer_above=_FINER_ABOVE)
        return bucket(candidates, smallest=_MIN_PADDED), pairs
    size = 2 * small_size
    while size < conflicts:
        size *= 4
    return small_size, size


def _renumber_slots(
    slot: Int[np.ndarray, "e"], new_index: Int[np.ndarray, "m"], views: int
) -> Int[np.ndarray, "e"]:
    """Return the slots with each candidate k replaced by new_index[k]."""
    owner, view = np.divmod(slot, views)
    return (new_index[owner] * views + view).astype(np.int32)


def label_frames(frame: Int[np.ndarray, "m"] | None, count: int) -> Int[np.ndarray, "m"]:
    """Return the frame of each of `count` candidates, (m,): 0 if `frame` is None."""
    return np.zeros(count, np.int32) if frame is None else frame.astype(np.int32)


@partial(kept_jit, static_argnames=("views",))
def _propagate(
    log_odds: Float[ArrayLike, "m"],
    is_selected: Bool[ArrayLike, "m"],
    start_messages: Float[ArrayLike, "m v"],
    from_greedy: Bool[ArrayLike, ""],
    slot: Int[ArrayLike, "e"],
    rival_slot: Int[ArrayLike, "e"],
    frame: Int[ArrayLike, "m"],
    rules: _Iteration,
    views: int,
) -> Float[ArrayLike, "m v"]:
    """Iterate the messages to all candidates until they converge, and return them, (m, v).

    With `from_greedy`, the initial messages are those of the candidates `is_selected`. Otherwise
    the initial messages are `start_messages`.
    """

    def message(odds: Float[ArrayLike, "m v"]) -> Float[ArrayLike, "m v"]:
        """Return the message to each slot, -log(1 + sum of the odds of its rivals)."""
        rival_odds = odds.reshape(-1)[rival_slot]
        total = jax.ops.segment_sum(
            rival_odds, slot, num_segments=odds.size, indices_are_sorted=True
        )
        return -jnp.log1p(total).reshape(-1, views)

    def step(state: _State) -> _State:
        messages, active, rounds_left = state
        total = log_odds + messages.sum(axis=1)
        cavity = total[:, None] - messages
        change = message(jnp.exp(jnp.minimum(cavity, _MAX_LOG_ODDS))) - messages
        largest_change = jax.ops.segment_max(
            jnp.abs(change).max(axis=1), frame, num_segments=len(active)
        )
        share = jnp.where(active[frame], 1 - rules.damping, 0.0)
        return (
            messages + share[:, None] * change,
            active & (largest_change >= rules.tolerance),
            rounds_left - 1,
        )

    def is_unfinished(state: _State) -> Bool[ArrayLike, ""]:
        return state[1].any() & (state[2] > 0)

    # At the start, only the candidates of the greedy choice send messages.
    selected_odds = jnp.where(is_selected, jnp.exp(jnp.minimum(log_odds, _MAX_LOG_ODDS)), 0.0)
    first = jnp.where(
        from_greedy, message(jnp.repeat(selected_odds[:, None], views, axis=1)), start_messages
    )
    active = jnp.ones(FRAMES_AT_ONCE, dtype=bool)
    return jax.lax.while_loop(is_unfinished, step, (first, active, jnp.asarray(rules.iterations)))[
        0
    ]


def choose_greedily(score: Float[np.ndarray, "m"], graph: ConflictGraph) -> Bool[np.ndarray, "m"]:
    """Return the mask of the accepted candidates, (m,): those with positive scores, the best first.

    A candidate is accepted if none of its rivals was accepted before.

    Notes
    -----
    In each round, every candidate with a larger score than all of its remaining rivals is accepted,
    and its rivals are excluded. Accepting one candidate at a time gives the same result.
    """
    is_accepted = score > 0
    owner, rival = graph.slot // graph.views, graph.rival_slot // graph.views
    is_edge = is_accepted[owner] & is_accepted[rival]
    owner, rival = owner[is_edge], rival[is_edge]
    # Candidates with equal scores keep their order.
    is_beaten = (score[rival] > score[owner]) | ((score[rival] == score[owner]) & (rival < owner))
    is_open = is_accepted.copy()
    while len(owner):
        loses = np.zeros(len(score), dtype=bool)
        loses[owner[is_beaten]] = True
        winners = is_open & ~loses
        is_excluded = np.zeros(len(score), dtype=bool)
        is_excluded[owner[winners[rival]]] = True
        is_accepted &= ~is_excluded
        is_open &= loses & ~is_excluded
        is_edge_open = is_open[owner] & is_open[rival]
        owner, rival, is_beaten = owner[is_edge_open], rival[is_edge_open], is_beaten[is_edge_open]
    return is_accepted
