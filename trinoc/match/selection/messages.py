"""Marginals under exclusion, by sum-product belief propagation.

On the factor graph of the conflicts, the message from a segment to a candidate is -log(1 + sum of
the rivals' cavity odds). The posterior log odds of a candidate are its prior log odds plus its
messages. We use marginals and not the MAP assignment: MAP may trade one strong triple for two weak
ones, and hides ambiguity.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.selection.exclusivity import ConflictGraph
from trinoc.match.tuning import DEFAULT, SelectionTuning
from trinoc.numerics import ArrayLike, bucket, finer_bucket, kept_jit, padded

# Frames that are one problem, at most.
FRAMES_AT_ONCE = 64

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
    # A candidate of padding has the last slots, which all conflicts of padding are between.
    candidates, conflicts = _capacities(count + 1, len(graph.slot))
    nobody = candidates * graph.views - 1
    given = np.zeros((count, graph.views)) if before is None else before.messages
    chosen = chosen_greedily(log_odds, graph) if before is None else np.zeros(count, dtype=bool)
    found, messages = _propagated(
        padded(log_odds, candidates, _NEVER),
        padded(chosen, candidates, False),
        padded(given, candidates),
        np.asarray(before is None),
        padded(graph.slot.astype(np.int32), conflicts, nobody),
        padded(graph.rival_slot.astype(np.int32), conflicts, nobody),
        padded(_frames(frame, count), candidates),
        _Rules(tuning.damping, tuning.settled, tuning.iterations),
        graph.views,
    )
    return Beliefs(np.asarray(found)[:count], np.asarray(messages)[:count])


def _capacities(candidates: int, conflicts: int) -> tuple[int, int]:
    """Of what is padded. Of few kinds where there are few, since one program more takes as long as
    hundreds of rounds on padding."""
    candidates = next((size for size in (256, 2048) if candidates <= size), bucket(candidates))
    if candidates > 2048 or conflicts > 1 << 16:
        return candidates, finer_bucket(conflicts)
    size = 2 * candidates
    while size < conflicts:
        size *= 4
    return candidates, size


def _frames(frame: Int[np.ndarray, "m"] | None, count: int) -> Int[np.ndarray, "m"]:
    return np.zeros(count, np.int32) if frame is None else frame.astype(np.int32)


@partial(kept_jit, static_argnames=("views",), beside_others=True)
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
) -> tuple[Float[ArrayLike, "m"], Float[ArrayLike, "m v"]]:
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
    left = jnp.asarray(rules.iterations)
    messages = jax.lax.while_loop(goes_on, step, (first, active, left))[0]
    return log_odds + messages.sum(axis=1), messages


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
