"""Tuned constants of step 1: candidates.

Tuned constants of scouting: what is learned from a sample of the segments of large pictures.
"""

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
    most_candidates: int = 1 << 18


@dataclass(frozen=True)
class ScoutTuning:
    """Where lines lie, learned before all pairs are tried. Shown by the rows of 2,900 segments per
    view and by the times (benchmarks/matching.py)."""

    # Pictures with more segments than this are scouted, by hand: below, it gains no time.
    above: int = 1500
    # Segments of each view that are matched for it, spread over the picture. By hand.
    sample: int = 300
    # Triples as likely as this say where lines lie; fewer than so many say nothing. By hand.
    sure: float = 0.9
    fewest: int = 60
    # Share of their ends that is left out at either side of the box, the margin about the rest as
    # a share of its side, and the least margin as a share of its longest side. By hand: what lies
    # further out is found by the segments that nothing inside explains.
    left_out: float = 0.0025
    margin: float = 0.16
    thinnest: float = 0.02
    # Candidates are let go that are so much less likely than selection asks, as far as the
    # sample tells. By hand: it learns the parameters anew.
    slack_log_odds: float = 1.5
    # Segments are explained by candidates as likely as this. By hand.
    explained: float = 0.5
    # Only pairs of which an end agrees are tried first, where ends agree: each end may be off by so
    # many of the largest scales of agreement, but for a share of wider ones, and by no more than a
    # share of the usual length of segments. By hand.
    ends_sigmas: float = 3.0
    ends_wider: float = 0.05
    ends_below: float = 0.125
    # Segments are searched again everywhere of which likely candidates show no more than this
    # share. By hand: .9 lost .002 of the triples of random2000_x4, .8 .003 and any part .013 of
    # those of 9,500 segments per view.
    covered: float = 0.95
