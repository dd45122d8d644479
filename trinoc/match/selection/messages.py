"""Marginals under exclusion, by sum-product belief propagation.

On the factor graph of the conflicts, the message from a segment to a candidate is -log(1 + sum of
the rivals' cavity odds). The posterior log odds of a candidate are its prior log odds plus its
messages. We use marginals and not the MAP assignment: MAP may trade one strong triple for two weak
ones, and hides ambiguity. Candidates without rivals hear nothing, and are left out.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.selection.exclusivity import ConflictGraph
from trinoc.match.tuning import DEFAULT, SelectionTuning
from trinoc.numerics import ArrayLike, bucket, padded

# Frames that are one problem, at most.
FRAMES_AT_ONCE = 64

# Of more conflicts than these, rounds on padding would take longer than another program.
# Padding beyond costs more than one small program more.
_FINER_ABOVE = 1 << 16
_FEW_CONFLICTS = 1 << 14
# Log odds whose exponential is no overflow, and such as nothing has.
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
        padded(_renumbered(own, number, graph.views), conflicts, nobody)
        for own in (graph.slot, graph.rival_slot)
    )
    messages = np.zeros((count, graph.views))
    given = messages if before is None else before.messages
    chosen = chosen_greedily(log_odds, graph) if before is None else np.zeros(count, dtype=bool)
    found = _propagated(
        padded(log_odds[rows], candidates, _NEVER),
        padded(chosen[rows], candidates, False),
        padded(given[rows], candidates),
        np.asarray(before is None),
        slot,
        rival_slot,
        padded(_frames(frame, count)[rows], candidates),
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
        rows, pairs = (bucket(n, finer_above=_FINER_ABOVE) for n in (candidates, conflicts))
        return few or rows, pairs
    size = 2 * few
    while size < conflicts:
        size *= 4
    return few, size


def _renumbered(
    slot: Int[np.ndarray, "e"], number: Int[np.ndarray, "m"], views: int
) -> Int[np.ndarray, "e"]:
    """Slots by new numbers of their candidates."""
    owner, view = np.divmod(slot, views)
    return (number[owner] * views + view).astype(np.int32)


def _frames(frame: Int[np.ndarray, "m"] | None, count: int) -> Int[np.ndarray, "m"]:
    return np.zeros(count, np.int32) if frame is None else frame.astype(np.int32)


@partial(jax.jit, static_argnames="views")
def _propagated(
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

    def goes_on(state: _State) -> Bool[ArrayLike, ""]:
        return state[1].any() & (state[2] > 0)

    # The start: only the candidates of the greedy choice send.
    alone = jnp.where(chosen, jnp.exp(jnp.minimum(log_odds, _HIGHEST)), 0.0)
    first = jnp.where(afresh, message(jnp.repeat(alone[:, None], views, axis=1)), before)
    active = jnp.ones(FRAMES_AT_ONCE, dtype=bool)
    return jax.lax.while_loop(goes_on, step, (first, active, jnp.asarray(rules.iterations)))[0]


def chosen_greedily(score: Float[np.ndarray, "m"], graph: ConflictGraph) -> Bool[np.ndarray, "m"]:
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
