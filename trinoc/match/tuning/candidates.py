"""Tuned constants of step 1: candidates."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CandidateTuning:
    """Step 1: which segments can be one line at all. Shown by row "1" of the fresh scenes and by
    "near epipolar" (benchmarks/matching.py); looser values cost time. Static in the kernels: one
    compilation for each value."""

    # Least common part, as a share of the shorter segment. From the prototype.
    smallest_overlap: float = 0.15
    # Chi-square (2 degrees of freedom) up to which three segments can be one line. By hand; one
    # in 22,000 true triples lies beyond if covariances are true.
    gate: float = 20.0
    # The gate in the picture, before the line is adjusted to all views, is so much wider. By hand.
    gate_slack: float = 1.1
    # The second longest segment is at least this share of the longest, on the line: chords of a
    # cylinder's rim against its silhouette are not. From the prototype.
    shortest_to_longest: float = 0.2
    # Sine of the least angle between the interpretation planes of a pair: below, its depth is
    # anything. By hand.
    smallest_crossing: float = 0.003
    # A pair that predicts worse than this in the third view predicts nothing, px. By hand, so
    # that short baselines predict too: their planes cross at small angles, all of them.
    vaguest_px: float = 6.0
    # Of the three orderings of a triple, that whose pair crosses best finds it, or one whose sine
    # is this share of the best. By hand.
    nearly_best: float = 0.8
    # What is predicted as well as this, in place and in direction, may be found by any ordering
    # where not all pairs are tried (large pictures). By hand, for time: vaguer ones find too much.
    well_known_px: float = 1.2
    well_known_rad: float = 0.0175
    # The middle of a prediction may lie this share of the picture outside. By hand.
    outside_share: float = 0.1
    # Standard deviations within which a segment may lie of where a pair predicts it. By hand.
    reach_sigmas: float = 4.0
    # Predictions shorter than this are looked up in their middle alone, px. By hand.
    one_sample_px: float = 16.0
    # Of more candidates than this in one block, those with log odds below are not kept: most of
    # what passes the gate is wrong, and takes memory. By hand, for large scenes.
    prune_above: int = 5000
    prune_log_odds: float = -9.0
    # Of more candidates than this in all, the likelier half is kept: it bounds the memory, some
    # 2 kB for each. By hand; no scene of 10,000 segments per view has them.
    most_candidates: int = 1 << 20
