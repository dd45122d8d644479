"""Tuned constants of step 3: pairs of views."""

from dataclasses import dataclass


@dataclass(frozen=True)
class OcclusionTuning:
    """Tuned constants of step 3, the matching of segments that only two views show.

    Their effect is visible in benchmarks/matching.py: "1+2+3", "step 3 alone", and calibration
    error.
    """

    # In images with many segments and no junctions, one end of a pair must agree within this factor
    # times the radius of triples. By hand: it halves the time.
    ends_factor: float = 3.0
    # A segment may be in a pair if less than this share of it is matched. From the prototype.
    max_matched_share: float = 0.5
    # Prior number of pairs, as a share of the lines matched in three views. By hand; estimated.
    prior_share: float = 0.1
    # Probability that a view misses a line inside its image. By hand.
    miss_probability: float = 0.5
    # Added to the log odds of every pair, so that posteriors equal the share of right ones. Fitted
    # on simulated scenes (seeds from 700,000 on); better on four of five kinds of scene.
    log_odds_offset: float = 2.25
    # The same for two views without a third. There the rates of lines by length, of ends and of
    # junctions, and the density of lines, are estimated from the pairs. `offset_unjoined` is added
    # in proportion to the share of ends that meet no other, since parts of one body fit each other
    # more often than by chance. All fitted on simulated scenes (seeds 8,000 to 8,019).
    log_odds_offset_alone: float = 1.75
    offset_unjoined: float = 0.75
    length_classes_px: tuple[float, ...] = (12.0, 18.0, 27.0, 40.0, 60.0, 90.0, 135.0)
    # Largest posterior of a pair in two views without side levels. Fitted on simulated scenes
    # (seeds 0 to 9).
    max_posterior_alone: float = 0.98
    # Temperature of tracks and pairs if all ends meet; reduction of its effect for tracks of
    # see-through bodies; offset of the log odds of pairs of solids; and penalty per sine of the
    # angle between the interpretation planes (`solids.py`). All fitted on simulated scenes: blocks
    # on a table, see-through boxes and loose segments (seeds from 1,100,000 on).
    solid_temperature: float = 0.15
    see_through_gain: float = 0.3
    solid_offset: float = 3.0
    viewpoint_penalty: float = 7.0
    # Segments cross if each extends beyond the other by more than this, px. By hand.
    crossing_margin_px: float = 3.0
    # Profiles of the density of lines: half width in standard deviations, width factor of the
    # outermost bins, and prior share of a uniform density. By hand.
    profile_sigmas: float = 4.0
    outer_bin_factor: float = 4.0
    uniform_share: float = 0.1
    # Companions. Range of the distance between parallel neighbours, px; largest distance of the end
    # from which a segment continues, px; prior share of pairs with a companion; smallest log ratio
    # of the shares that has an effect; largest log odds that are added; smallest posterior of a
    # companion in the first round. By hand.
    companion_distance_px: tuple[float, float] = (1.5, 15.0)
    continuation_px: float = 8.0
    companion_share: float = 0.05
    min_companion_ratio: float = 0.5
    max_companion_log_odds: float = 4.0
    min_companion_posterior: float = 0.02
    # `log_odds_offset` for segments with side levels, which come from images, where clutter is
    # correlated. Fitted with `EvidenceTuning.temperature` on rendered scenes (seeds 0 to 5 and 12
    # to 17).
    log_odds_offset_in_images: float = -1.5
