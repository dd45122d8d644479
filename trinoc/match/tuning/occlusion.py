"""Tuned constants of step 3: pairs of views."""

from dataclasses import dataclass


@dataclass(frozen=True)
class OcclusionTuning:
    """Step 3: pairs of views. Shown by "1+2+3" and "step 3 alone", and the calibration error
    (benchmarks/matching.py)."""

    # In large pictures whose ends meet no others, pairs have an end that agrees by so many times
    # what triples need. By hand: it halves their time.
    ends_reach: float = 3.0
    # A segment of which less than this is matched may be half of a pair. From the prototype.
    max_matched_share: float = 0.5
    # Pairs before any is known, as a share of the lines matched in three views; and how many pairs
    # have a companion. By hand; learned.
    prior_share: float = 0.1
    # Probability that a view misses a line within its borders. By hand.
    missed: float = 0.5
    # Added to the log odds of every pair, so that posteriors match the share that is right. Between
    # what was fitted on made scenes of three views (seeds from 700,000 on: 2.25) and of two (seeds
    # 8,000 to 8,019: 1.75).
    log_odds_offset: float = 2.0
    # In two views, however well a pair fits, it is right no oftener than this, where no levels
    # beside segments are known. Fitted on made scenes (seeds 0 to 9).
    most_alone: float = 0.98
    # Temperature of tracks and pairs of solids, whose ends meet (`solids.py`), fitted on made
    # scenes: blocks, see-through boxes, loose segments (seeds from 1,100,000 on).
    solid_temperature: float = 0.15
    # By how much less it counts of tracks of bodies that are seen through. Fitted to the same; at 1
    # a view that is shifted by 5 px is no longer suspect.
    seen_through_gain: float = 0.3
    # Added to log odds of such pairs. By hand, on made blocks (seeds 131,000 to 131,002).
    solid_offset: float = -1.0
    # What share of lines lies anywhere before a line is known. By hand.
    place_anywhere: float = 0.1
    # Parallel segments nearer than this, px, are no companions. By hand. Shown by frames of bars
    # (benchmarks/companions.py): without it their precision is .014 lower.
    beside_px: float = 1.5
    # The same for segments with side levels, of pictures, where clutter is alike: with
    # `EvidenceTuning.temperature` fitted on rendered scenes (seeds 0 to 5 and 12 to 17).
    log_odds_offset_in_images: float = -1.5
