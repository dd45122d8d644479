"""Step 2: which candidates are true, from their evidence, their rivals and their neighbours."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.candidates import Candidates, odds_of
from trinoc.match.evidence import Habits, learn, probability, tempered, usual_habits
from trinoc.match.exclusivity import Conflicts, beliefs, chosen_greedily, conflicts
from trinoc.match.merging import Tracks
from trinoc.match.neighbours import USUAL_HABITS, JunctionHabits, junctions, support

ROUNDS = 4
NEIGHBOUR_ROUNDS = 4
# Candidates with log odds below these are let go: while habits are learned, and after.
LIKELY, HOPELESS_LEARNED = -2.0, -5.0
# With fewer junctions than this share of ends there is no structure to speak of.
LEAST_JOINED = 0.1


class Selection(NamedTuple):
    """Candidates in the running, their log odds alone and among rivals, and which were taken."""

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    belief: Float[np.ndarray, "m"]
    taken: Bool[np.ndarray, "m"]
    graph: Conflicts
    habits: Habits
    joined: JunctionHabits


def select(candidates: Candidates, typical_count: float, *, neighbours: bool = True) -> Selection:
    """Learn the habits of the pictures at hand, and take candidates in order of belief.

    Without `neighbours`, by their own evidence and their rivals' alone.
    """
    habits = usual_habits(candidates.ends_mm, typical_count)
    # What is learned is learned from likely candidates: far fewer, with far fewer conflicts.
    likely = _above(candidates, odds_of(candidates, habits), LIKELY)
    graph = conflicts(likely.index, likely.part)
    for _ in range(ROUNDS):
        belief = beliefs(odds_of(likely, habits), graph)
        habits = _learned(likely, belief, habits)
    candidates = _above(candidates, odds_of(candidates, habits), HOPELESS_LEARNED)
    graph = conflicts(candidates.index, candidates.part)
    odds = odds_of(candidates, habits)
    belief = beliefs(odds, graph)
    joined = USUAL_HABITS
    if neighbours:
        odds, belief, joined = _with_neighbours(candidates, graph, odds, belief, habits)
    return Selection(
        candidates, odds, belief, chosen_greedily(belief, graph), graph, habits, joined
    )


def tracks_of(selection: Selection) -> Tracks:
    """What was taken, with the belief of the best rival of each."""
    graph = selection.graph
    runner_up = np.full(len(selection.belief), -np.inf)
    owner, rival = graph.slot // graph.views, graph.rival_slot // graph.views
    np.maximum.at(runner_up, owner, selection.belief[rival])
    taken = selection.taken
    candidates = Candidates(*(field[taken] for field in selection.candidates))
    belief, rivals = (
        tempered(values[taken], candidates.side_log) for values in (selection.belief, runner_up)
    )
    return Tracks(candidates, belief, rivals)


def _with_neighbours(
    candidates: Candidates,
    graph: Conflicts,
    odds: Float[np.ndarray, "m"],
    belief: Float[np.ndarray, "m"],
    habits: Habits,
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"], JunctionHabits]:
    meetings, joined = junctions(candidates), USUAL_HABITS
    log_ends_density = habits.log_count - habits.volume.log_size + np.log(2)
    alone = odds, belief
    for _ in range(NEIGHBOUR_ROUNDS):
        gain, joined = support(meetings, probability(belief), log_ends_density, joined)
        odds = alone[0] + gain
        belief = beliefs(odds, graph)
    if joined.joined < LEAST_JOINED:
        return *alone, joined
    return odds, belief, joined


def _above(candidates: Candidates, odds: Float[np.ndarray, "m"], least: float) -> Candidates:
    return Candidates(*(field[odds > least] for field in candidates))


def _learned(candidates: Candidates, belief: Float[np.ndarray, "m"], habits: Habits) -> Habits:
    c = candidates
    return learn(c.chi_square, c.end_log, c.ends_mm, c.side_log, probability(belief), habits)
