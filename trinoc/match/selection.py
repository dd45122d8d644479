"""Step 2: which candidates are true, from their evidence, their rivals and their neighbours."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.match.candidates import Candidates
from trinoc.match.ends import USUAL_SHARES
from trinoc.match.evidence import (
    USUAL_TAIL,
    Habits,
    learn,
    log_line_density,
    log_odds,
    probability,
)
from trinoc.match.exclusivity import Conflicts, beliefs, chosen_greedily, conflicts

ROUNDS = 4
# Candidates with log odds below this before any rivalry are let go.
HOPELESS = -6.0


class Selection(NamedTuple):
    """Candidates in the running, their log odds alone and among rivals, and which were taken."""

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    belief: Float[np.ndarray, "m"]
    taken: np.ndarray
    graph: Conflicts
    habits: Habits


def select(candidates: Candidates, typical_count: float) -> Selection:
    """Learn the habits of the pictures at hand, and take candidates in order of belief."""
    middles = candidates.ends_mm.mean(axis=1)
    share = np.full(len(middles), min(1.0, typical_count / max(len(middles), 1)))
    habits = Habits(
        USUAL_TAIL / USUAL_TAIL.sum(),
        USUAL_SHARES / USUAL_SHARES.sum(),
        log_line_density(middles, share),
    )
    odds = _odds(candidates, habits)
    candidates = Candidates(*(field[odds > HOPELESS] for field in candidates))
    middles = candidates.ends_mm.mean(axis=1)
    graph = conflicts(candidates.index, candidates.part)
    belief = _odds(candidates, habits)
    for _ in range(ROUNDS):
        belief = beliefs(_odds(candidates, habits), graph)
        habits = learn(
            candidates.chi_square, candidates.end_log, middles, probability(belief), habits
        )
    odds = _odds(candidates, habits)
    belief = beliefs(odds, graph)
    return Selection(candidates, odds, belief, chosen_greedily(belief, graph), graph, habits)


def _odds(candidates: Candidates, habits: Habits) -> Float[np.ndarray, "m"]:
    return log_odds(candidates.chi_square, candidates.log_density, candidates.end_log, habits)
