"""Tuned constants of step 1: candidates, and scouting in images with many segments."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CandidateTuning:
    """Tuned constants of step 1, the search for segments that can be images of one line.

    Their effect is visible in benchmarks/matching.py: row "1" of the fresh scenes, and "near
    epipolar". Looser values need more time. Each value is compiled into the programs, so a new
    value compiles them again.
    """

    # Smallest common part, as a share of the shorter segment. From the prototype.
    smallest_overlap: float = 0.15
    # Largest chi-square (2 degrees of freedom) of three segments of one line. By hand: with correct
    # covariances, one in 22,000 true triples exceeds it.
    gate: float = 20.0
    # Factor of the gate before the line is fitted to all views. By hand.
    gate_slack: float = 1.1
    # Smallest ratio of the second longest to the longest segment, on the line. It rejects chords of
    # a cylinder's rim matched with its silhouette. From the prototype.
    shortest_to_longest: float = 0.2
    # Smallest sine of the angle between the interpretation planes of a pair. Below it, the depth is
    # undetermined. By hand.
    smallest_crossing: float = 0.003
    # Largest standard deviation of a pair's prediction in the third view, px. By hand. It allows
    # short baselines, whose planes all cross at small angles.
    max_prediction_sigma_px: float = 6.0
    # A pair predicts if the sine of its crossing angle is at least this share of the best of the
    # three orderings. By hand.
    min_crossing_share: float = 0.8
    # A prediction with smaller errors of position (px) and direction (rad) may be used in any
    # ordering, where not all pairs are tried (many segments). By hand, for time.
    precise_px: float = 1.2
    precise_rad: float = 0.0175
    # The middle of a prediction may lie this share of the image size outside the image. By hand.
    outside_share: float = 0.1
    # Search radius about a prediction, in standard deviations. By hand.
    search_sigmas: float = 4.0
    # Predictions shorter than this are searched at their middle only, px. By hand.
    one_sample_px: float = 16.0
    # If one block has more candidates than this, those with lower log odds are discarded: most of
    # them are wrong, and they occupy memory. By hand, for large scenes.
    prune_above: int = 5000
    prune_log_odds: float = -9.0
    # If there are more candidates than this in all, the more likely half is kept. It limits the
    # memory, about 2 kB each. By hand; no scene of 10,000 segments per view reaches it.
    max_candidates: int = 1 << 18


@dataclass(frozen=True)
class ScoutTuning:
    """Tuned constants of the search in images with many segments.

    A sample of the segments restricts this search to a region and to likely candidates.

    Their effect is visible in benchmarks/matching.py: rows of 2,900 segments per view, and times.
    """

    # Images with more segments are scouted. By hand: with fewer, scouting saves no time.
    min_segments: int = 1500
    # Number of segments of each view in the sample, spread over the image. By hand.
    sample_size: int = 300
    # Posterior of the triples that determine the region, and their smallest number. By hand.
    sure_posterior: float = 0.9
    min_sure_triples: int = 60
    # Share of the ends that is trimmed at either side of the box; margin, as a share of the side;
    # smallest margin, as a share of the longest side. By hand. Lines outside are found later, since
    # nothing inside the box explains their segments.
    trimmed_share: float = 0.0025
    margin: float = 0.16
    min_side_share: float = 0.02
    # Candidates are discarded if their log odds are this much below the limit of the selection. By
    # hand: the selection estimates the parameters again.
    slack_log_odds: float = 1.5
    # Posterior of the candidates that explain a segment. By hand.
    explained_posterior: float = 0.5
    # If ends agree, only pairs that agree at one end are tried first. An end may deviate by this
    # number of the largest agreement scales, apart from a share of wider ones, and by no more than
    # a share of the typical length. By hand.
    ends_sigmas: float = 3.0
    wide_ends_share: float = 0.05
    max_ends_share: float = 0.125
    # Segments are searched again everywhere if likely candidates cover no more than this share of
    # them. By hand: 0.9 lost 0.002 of the triples of random2000_x4. In scenes of 9,500 segments per
    # view, 0.8 lost 0.003 and any coverage 0.013.
    explained_share: float = 0.95
