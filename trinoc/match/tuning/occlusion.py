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
    # Pairs before any is known, as a share of the lines matched in three views. By hand; learned.
    prior_share: float = 0.1
    # Probability that a view misses a line within its borders. By hand.
    missed: float = 0.5
    # Added to the log odds of every pair, so that posteriors match the share that is right: fitted
    # on made scenes (seeds from 700,000 on), better on four of five kinds of scene.
    log_odds_offset: float = 2.25
    # The same in two views, where no third checks: rates of lines by length, of ends and of
    # junctions, and where lines lie, are learned from the pairs. More is added as fewer ends meet:
    # parts of one body fit each other by more than chance. All fitted on made scenes (seeds 8,000
    # to 8,019).
    log_odds_offset_alone: float = 1.75
    offset_unjoined: float = 0.75
    length_classes_px: tuple[float, ...] = (12.0, 18.0, 27.0, 40.0, 60.0, 90.0, 135.0)
    # In two views, however well a pair fits, it is right no oftener than this, where no levels
    # beside segments are known. Fitted on made scenes (seeds 0 to 9).
    most_alone: float = 0.98
    # Temperature of tracks and pairs where all ends meet, and by how much less it counts of tracks
    # of bodies that are seen through; what is added to log odds of pairs of solids, and taken off
    # by the sine of the angle between the interpretation planes (`solids.py`). All fitted on made
    # scenes, blocks on a table, see-through boxes and loose segments (seeds from 1,100,000 on).
    solid_temperature: float = 0.15
    seen_through_gain: float = 0.3
    solid_offset: float = 3.0
    doubt_turned: float = 7.0
    # Segments that cross each other do so by more than this beyond either, px. By hand.
    crossing_margin_px: float = 3.0
    # Profiles of where lines lie, over so many standard deviations to either side; how much wider
    # the outermost bins count; what share lies anywhere before a line is known. By hand.
    place_reach: float = 4.0
    place_beyond: float = 4.0
    place_anywhere: float = 0.1
    # Companions: parallel segments are beside each other at distances between these, px, and
    # segments go on from ends as near as that, px. By hand, as is all that follows: the share of
    # pairs that have one before any is known; the log ratio of shares below which nothing is added;
    # the most that is added; and how likely who supports must be at first.
    beside_px: tuple[float, float] = (1.5, 15.0)
    continues_px: float = 8.0
    companion_share: float = 0.05
    least_companion_ratio: float = 0.5
    most_companion: float = 4.0
    companion_likely: float = 0.02
    # The same for segments with side levels, of pictures, where clutter is alike: with
    # `EvidenceTuning.temperature` fitted on rendered scenes (seeds 0 to 5 and 12 to 17).
    log_odds_offset_in_images: float = -1.5
