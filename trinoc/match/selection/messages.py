"""Marginals under exclusion, by sum-product belief propagation.

On the factor graph of the conflicts, the message from a segment to a candidate is -log(1 + sum of
the rivals' cavity odds). The posterior log odds of a candidate are its prior log odds plus its
messages. We use marginals and not the MAP assignment: MAP may trade one strong triple for two weak
ones, and hides ambiguity. Most candidates share most of their segments with nobody: messages are
computed for slots in conflict alone, the others are zero.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.selection.exclusivity import ConflictGraph
from trinoc.match.tuning import DEFAULT, SelectionTuning
from trinoc.numerics import ArrayLike, finer_bucket, kept_jit, padded

# Frames that are one problem, at most.
FRAMES_AT_ONCE = 64

# Log odds whose exponential is no overflow, and such as nothing has.
_HIGHEST, _NEVER = 60.0, -1e4


class _Rules(NamedTuple):
    damping: Float[ArrayLike, ""] | float
    settled: Float[ArrayLike, ""] | float
    iterations: Int[ArrayLike, ""] | int


class _Contest(NamedTuple):
    """Slots in conflict: the others of the same candidate (the last slot where there are fewer),
    their frames, and the edges between slots, sorted by the first."""

    others: tuple[Int[ArrayLike, "_s"], ...]
    frame: Int[ArrayLike, "s"]
    slot: Int[ArrayLike, "e"]
    rival_slot: Int[ArrayLike, "e"]


# Messages, which frames have not settled, how many rounds are left.
_State = tuple[Float[ArrayLike, "s"], Bool[ArrayLike, "f"], Int[ArrayLike, ""]]


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
    slots = graph.slot[np.flatnonzero(np.diff(graph.slot, prepend=-1))]
    contest, owner = _contest(graph, slots, frame), slots // graph.views
    chosen = chosen_greedily(log_odds, graph) if before is None else np.zeros(count, dtype=bool)
    messages = np.zeros(count * graph.views)
    given = messages if before is None else before.messages.reshape(-1)
    size = len(contest.frame)
    found = _propagated(
        padded(log_odds[owner], size, _NEVER),
        padded(chosen[owner], size, False),
        padded(given[slots], size),
        np.asarray(before is None),
        contest,
        _Rules(tuning.damping, tuning.settled, tuning.iterations),
    )
    messages[slots] = np.asarray(found)[: len(slots)]
    messages = messages.reshape(-1, graph.views)
    return Beliefs(log_odds + messages.sum(axis=1), messages)


def _capacities(slots: int, conflicts: int) -> tuple[int, int]:
    """Of what is padded. Of few kinds where there are few, since one program more takes as long as
    hundreds of rounds on padding."""
    few = next((size for size in (256, 2048) if slots <= size), None)
    if few is None:
        return finer_bucket(slots), finer_bucket(conflicts)
    size = 2 * few
    while size < conflicts:
        size *= 4
    return few, size


def _contest(
    graph: ConflictGraph, slots: Int[np.ndarray, "s"], frame: Int[np.ndarray, "m"] | None
) -> _Contest:
    """The slots numbered among themselves. The last one is of padding, whose message is none and
    which all conflicts of padding are between."""
    size, conflicts = _capacities(len(slots) + 1, len(graph.slot))
    owner, view = np.divmod(slots, graph.views)
    number = np.full((owner[-1] + 1) * graph.views, size - 1, np.int32)
    number[slots] = np.arange(len(slots), dtype=np.int32)
    of_owner = number.reshape(-1, graph.views)
    others = [of_owner[owner, (view + turn) % graph.views] for turn in range(1, graph.views)]
    own = np.zeros(len(slots), np.int32) if frame is None else frame[owner].astype(np.int32)
    return _Contest(
        tuple(padded(other, size, size - 1) for other in others),
        padded(own, size),
        padded(number[graph.slot], conflicts, size - 1),
        padded(number[graph.rival_slot], conflicts, size - 1),
    )


@partial(kept_jit, beside_others=True)
def _propagated(
    log_odds: Float[ArrayLike, "s"],
    chosen: Bool[ArrayLike, "s"],
    before: Float[ArrayLike, "s"],
    afresh: Bool[ArrayLike, ""],
    contest: _Contest,
    rules: _Rules,
) -> Float[ArrayLike, "s"]:
    """Messages of slots, given their candidates' log odds and choice, and the messages before."""
    others, frame, slot, rival_slot = contest
    size = log_odds.size

    def message(odds: Float[ArrayLike, "s"]) -> Float[ArrayLike, "s"]:
        """What each slot hears, given what each says."""
        return -jnp.log1p(jax.ops.segment_sum(odds[rival_slot], slot, size, True))

    def step(state: _State) -> _State:
        messages, active, left = state
        cavity = sum((messages[own] for own in others), start=log_odds)
        change = message(jnp.exp(jnp.minimum(cavity, _HIGHEST))) - messages
        worst = jax.ops.segment_max(jnp.abs(change), frame, num_segments=len(active))
        share = jnp.where(active[frame], 1 - rules.damping, 0.0)
        return messages + share * change, active & (worst >= rules.settled), left - 1

    def goes_on(state: _State) -> Bool[ArrayLike, ""]:
        return state[1].any() & (state[2] > 0)

    # The start: only the candidates of the greedy choice send.
    alone = jnp.where(chosen, jnp.exp(jnp.minimum(log_odds, _HIGHEST)), 0.0)
    first = jnp.where(afresh, message(alone), before)
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
