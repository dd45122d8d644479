"""Marginals under exclusion, by sum-product belief propagation.

On the factor graph of the conflicts, the message from a segment to a candidate is -log(1 + sum of
the rivals' cavity odds). The posterior log odds of a candidate are its prior log odds plus its
messages. We use marginals and not the MAP assignment: MAP may trade one strong triple for two weak
ones, and hides ambiguity. Candidates without rivals hear nothing, and are left out.

Each part of a segment belongs to one line at most: which candidates exclude each other.
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
    """Directed edges, sorted by slot = candidate * views + view.

    slot : who is limited, and through which segment. rival_slot : by whom.
    """

    slot: Int[np.ndarray, "e"]
    rival_slot: Int[np.ndarray, "e"]
    views: int


def conflict_graph(
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: SelectionTuning = DEFAULT.selection,
) -> ConflictGraph:
    """Which candidates claim the same part of a segment; -1 in `index` claims nothing.

    Two candidates that share parts in several views conflict once, in the first of these.
    """
    views = index.shape[1]
    # The interval on each segment, from low to high.
    low, high = interval.min(axis=2), interval.max(axis=2)

    def clash(m: Int[np.ndarray, "e"], n: Int[np.ndarray, "e"], view: int) -> np.ndarray:
        bounds = low[m, view], high[m, view], low[n, view], high[n, view]
        return _clash(*bounds, tuning.conflict_overlap)

    slots, rivals = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
    for view in range(views):
        seen = np.flatnonzero(index[:, view] >= 0)
        for m, n in pairs_of_equal_keys(index[seen, view]):
            m, n = seen[m], seen[n]
            fresh = clash(m, n, view)
            m, n = m[fresh], n[fresh]
            for earlier in range(view):
                both = (index[m, earlier] == index[n, earlier]) & (index[m, earlier] >= 0)
                counted = both & clash(m, n, earlier)
                m, n = m[~counted], n[~counted]
            m, n = ((x * views + view).astype(np.int32) for x in (m, n))
            slots += [m, n]
            rivals += [n, m]
    # Both in one number: sorting it is several times faster than by slot.
    edges = np.concatenate(slots).astype(np.int64) << 32
    edges |= np.concatenate(rivals)
    edges.sort()
    return ConflictGraph((edges >> 32).astype(np.int32), edges.astype(np.int32), views)


def affordable(
    log_odds: Float[np.ndarray, "m"],
    index: Int[np.ndarray, "m v"],
    above: float,
    tuning: SelectionTuning = DEFAULT.selection,
) -> Int[np.ndarray, "k"]:
    """Rows of candidates of log odds `above` that: all of them, or the likeliest, with as many
    conflicts as memory bears."""
    kept = np.flatnonzero(log_odds > above)
    log_odds, index = log_odds[kept], index[kept]

    def conflicts(least: float) -> int:
        rows = index[log_odds >= least]
        every = (np.bincount(rows[rows[:, view] >= 0, view]) for view in range(index.shape[1]))
        return sum(int((count**2).sum()) for count in every)

    least = -np.inf
    if conflicts(least) > tuning.most_conflicts:
        # Equals are kept or let go together, all of them where there are too many of the likeliest.
        ordered = np.append(np.unique(log_odds), np.inf)
        fits = bisect_left(ordered, True, key=lambda odds: conflicts(odds) <= tuning.most_conflicts)
        least = ordered[fits]
    return kept[log_odds >= least]


def log_share_kept(
    log_odds: Float[np.ndarray, "m"], index: Int[np.ndarray, "m v"], kept: Int[np.ndarray, "k"]
) -> Float[np.ndarray, "k"]:
    """Log of how much of the odds of all candidates of a segment is that of the kept ones; of each
    kept candidate, the least of its segments.

    It is the probability that what is right is among those kept, where the others were let go for
    memory and not for their evidence.
    """
    share = np.zeros(len(kept))
    for view in range(index.shape[1]):
        segment = index[:, view]
        on = np.flatnonzero(segment >= 0)
        count = int(segment.max(initial=-1)) + 1
        # That nothing is right has odds of 1.
        top = np.zeros(count)
        np.maximum.at(top, segment[on], log_odds[on])
        odds = np.zeros(len(segment))
        odds[on] = np.exp(log_odds[on] - top[segment[on]])
        nothing = np.exp(-top)
        of_kept = kept[segment[kept] >= 0]
        every = np.bincount(segment[on], odds[on], count) + nothing
        those = np.bincount(segment[of_kept], odds[of_kept], count) + nothing
        own = np.where(segment[kept] >= 0, segment[kept], 0)
        log_share = np.log(those / every)[own] if count else share
        share = np.minimum(share, np.where(segment[kept] >= 0, log_share, 0.0))
    return share


def with_log_share(
    log_odds: Float[np.ndarray, "m"], log_share: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m"]:
    """Log odds of probabilities that are times a share."""
    # log(p s / (1 - p s)), as p = 1 / (1 + exp(-x)): exp(x - log s) is what p s lacks.
    lacking = np.expm1(-log_share)
    return -np.logaddexp(-log_odds - log_share, np.log(np.maximum(lacking, 1e-300)))


def are_claimed(
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    by_index: Int[np.ndarray, "t v"],
    by_part: Float[np.ndarray, "t v 2"],
    tuning: SelectionTuning = DEFAULT.selection,
) -> Bool[np.ndarray, "m"]:
    """Whether candidates need a part of a segment that one of other lines has."""
    taken = np.zeros(len(index), dtype=bool)
    for view in range(index.shape[1]):
        owners = np.argsort(by_index[:, view], kind="stable")
        segments = by_index[owners, view]
        seen = np.flatnonzero(index[:, view] >= 0)
        m, position = expand_ranges(
            np.searchsorted(segments, index[seen, view], "left"),
            np.searchsorted(segments, index[seen, view], "right"),
        )
        m, by = seen[m], owners[position]
        own, other = interval[m, view], by_part[by, view]
        bounds = own.min(axis=1), own.max(axis=1), other.min(axis=1), other.max(axis=1)
        clash = _clash(*bounds, tuning.conflict_overlap)
        taken[m[clash]] = True
    return taken


def _clash(
    low: Float[np.ndarray, "e"],
    high: Float[np.ndarray, "e"],
    other_low: Float[np.ndarray, "e"],
    other_high: Float[np.ndarray, "e"],
    least_share: float,
) -> Bool[np.ndarray, "e"]:
    shared = np.minimum(high, other_high) - np.maximum(low, other_low)
    return shared > least_share * np.minimum(high - low, other_high - other_low)


# numerical: frames that are one problem, at most.
FRAMES_AT_ONCE = 64

# numerical: of more conflicts than these, rounds on padding would take longer than another
# program. Padding beyond costs more than one small program more.
_FINER_ABOVE = 1 << 16
# numerical: as above. Of more conflicts, or candidates than 2048, so many candidates are padded.
_FEW_CONFLICTS = 1 << 14
_LEAST_OF_MANY = 1 << 12  # numerical: as above
# numerical: log odds whose exponential is no overflow, and such as nothing has.
_HIGHEST, _NEVER = 60.0, -1e4


class _Rules(NamedTuple):
    damping: Float[ArrayLike, ""] | float
    settled: Float[ArrayLike, ""] | float
    iterations: Int[ArrayLike, ""] | int


# Messages (candidates, views), which frames have not settled, how many rounds are left.
_State = tuple[Float[ArrayLike, "m v"], Bool[ArrayLike, "f"], Int[ArrayLike, ""]]


class Beliefs(NamedTuple):
    """Log odds of each candidate after exclusion; the messages that they come from."""

    log_odds: Float[np.ndarray, "m"]
    messages: Float[np.ndarray, "m v"]


def sum_product(
    log_odds: Float[np.ndarray, "m"],
    graph: ConflictGraph,
    tuning: SelectionTuning = DEFAULT.selection,
    frame: Int[np.ndarray, "m"] | None = None,
    before: Beliefs | None = None,
) -> Beliefs:
    """The fixed point of the messages, from the greedy choice on, or from where they were `before`
    under other odds.

    Candidates of several frames (`frame`, below FRAMES_AT_ONCE) each have as many rounds as their
    own frame takes to settle.
    """
    count = len(log_odds)
    if len(graph.slot) == 0:
        return Beliefs(log_odds, np.zeros((count, graph.views)))
    rival = np.zeros(count, dtype=bool)
    rival[graph.slot // graph.views] = True
    rows, number = np.flatnonzero(rival), np.cumsum(rival) - 1
    candidates, conflicts = _capacities(len(rows) + 1, len(graph.slot))
    # A candidate of padding has the last slots, which all conflicts of padding are between.
    nobody = candidates * graph.views - 1
    slot, rival_slot = (
        pad_rows(_renumber_slots(own, number, graph.views), conflicts, nobody)
        for own in (graph.slot, graph.rival_slot)
    )
    messages = np.zeros((count, graph.views))
    given = messages if before is None else before.messages
    chosen = choose_greedily(log_odds, graph) if before is None else np.zeros(count, dtype=bool)
    found = _propagate(
        pad_rows(log_odds[rows], candidates, _NEVER),
        pad_rows(chosen[rows], candidates, False),
        pad_rows(given[rows], candidates),
        np.asarray(before is None),
        slot,
        rival_slot,
        pad_rows(label_frames(frame, count)[rows], candidates),
        _Rules(tuning.damping, tuning.settled, tuning.iterations),
        graph.views,
    )
    messages[rows] = np.asarray(found)[: len(rows)]
    return Beliefs(log_odds + messages.sum(axis=1), messages)


def _capacities(candidates: int, conflicts: int) -> tuple[int, int]:
    """Of what is padded. Of few kinds where there are few, since one program more takes as long as
    hundreds of rounds on padding."""
    few = next((size for size in (256, 2048) if candidates <= size), None)
    if few is None or conflicts > _FEW_CONFLICTS:
        pairs = bucket(conflicts, smallest=2 * _FEW_CONFLICTS, finer_above=_FINER_ABOVE)
        return bucket(candidates, smallest=_LEAST_OF_MANY), pairs
    size = 2 * few
    while size < conflicts:
        size *= 4
    return few, size


def _renumber_slots(
    slot: Int[np.ndarray, "e"], number: Int[np.ndarray, "m"], views: int
) -> Int[np.ndarray, "e"]:
    """Slots by new numbers of their candidates."""
    owner, view = np.divmod(slot, views)
    return (number[owner] * views + view).astype(np.int32)


def label_frames(frame: Int[np.ndarray, "m"] | None, count: int) -> Int[np.ndarray, "m"]:
    """The frame of each of `count` candidates, 0 where there is no stack."""
    return np.zeros(count, np.int32) if frame is None else frame.astype(np.int32)


@partial(kept_jit, static_argnames=("views",))
def _propagate(
    log_odds: Float[ArrayLike, "m"],
    chosen: Bool[ArrayLike, "m"],
    before: Float[ArrayLike, "m v"],
    afresh: Bool[ArrayLike, ""],
    slot: Int[ArrayLike, "e"],
    rival_slot: Int[ArrayLike, "e"],
    frame: Int[ArrayLike, "m"],
    rules: _Rules,
    views: int,
) -> Float[ArrayLike, "m v"]:
    """Messages to candidates, from a greedy choice of theirs or from the messages before."""

    def message(odds: Float[ArrayLike, "m v"]) -> Float[ArrayLike, "m v"]:
        """What each slot hears, given what each says."""
        heard = odds.reshape(-1)[rival_slot]
        total = jax.ops.segment_sum(heard, slot, num_segments=odds.size, indices_are_sorted=True)
        return -jnp.log1p(total).reshape(-1, views)

    def step(state: _State) -> _State:
        messages, active, left = state
        total = log_odds + messages.sum(axis=1)
        cavity = total[:, None] - messages
        change = message(jnp.exp(jnp.minimum(cavity, _HIGHEST))) - messages
        worst = jax.ops.segment_max(jnp.abs(change).max(axis=1), frame, num_segments=len(active))
        share = jnp.where(active[frame], 1 - rules.damping, 0.0)
        return messages + share[:, None] * change, active & (worst >= rules.settled), left - 1

    def is_unfinished(state: _State) -> Bool[ArrayLike, ""]:
        return state[1].any() & (state[2] > 0)

    # The start: only the candidates of the greedy choice send.
    alone = jnp.where(chosen, jnp.exp(jnp.minimum(log_odds, _HIGHEST)), 0.0)
    first = jnp.where(afresh, message(jnp.repeat(alone[:, None], views, axis=1)), before)
    active = jnp.ones(FRAMES_AT_ONCE, dtype=bool)
    return jax.lax.while_loop(is_unfinished, step, (first, active, jnp.asarray(rules.iterations)))[
        0
    ]


def choose_greedily(score: Float[np.ndarray, "m"], graph: ConflictGraph) -> Bool[np.ndarray, "m"]:
    """Taken in order of score, where positive and not in conflict with one taken.

    Whoever beats all of its rivals that are left is taken, and bars them: in as many rounds as
    the longest chain of rivals has links, and what taking one by one gives.
    """
    taken = score > 0
    owner, rival = graph.slot // graph.views, graph.rival_slot // graph.views
    both = taken[owner] & taken[rival]
    owner, rival = owner[both], rival[both]
    # Of equals, the first comes first.
    beaten = (score[rival] > score[owner]) | ((score[rival] == score[owner]) & (rival < owner))
    open_ = taken.copy()
    while len(owner):
        loses = np.zeros(len(score), dtype=bool)
        loses[owner[beaten]] = True
        winners = open_ & ~loses
        barred = np.zeros(len(score), dtype=bool)
        barred[owner[winners[rival]]] = True
        taken &= ~barred
        open_ &= loses & ~barred
        left = open_[owner] & open_[rival]
        owner, rival, beaten = owner[left], rival[left], beaten[left]
    return taken
