"""Tuned constants of the observations and of the evidence: clutter, side levels, ends, tails."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ClutterTuning:
    """Tuned constants of the clutter model, the density of segments that belong to no line.

    Their effect is visible in benchmarks/matching.py: merton1 and merton2, which have locally dense
    texture, and the fresh scenes.
    """

    # The local density of clutter is that of this number of neighbours. By hand.
    neighbours: int = 25


@dataclass(frozen=True)
class ObservationTuning:
    """Tuned constants for the exclusion of segments that are too uncertain or duplicate.

    No benchmark depends on these constants. The exclusion is needed because a saturated edge may
    have any reported error.
    """

    # Largest standard deviation of a segment across itself, px; its length is a limit too. By hand:
    # twice the value of the most blurred edges of photographs.
    max_sigma_across_px: float = 8.0
    # Segments of one view are duplicates if their ends agree within this share of the standard
    # deviation across. By hand.
    duplicate_sigmas: float = 0.25


@dataclass(frozen=True)
class SideTuning:
    """Tuned constants of the evidence of grey levels beside segments.

    The constants that are grey levels are percentages of the range of all levels in an image. Their
    effect is visible in benchmarks/matching.py: row "with side levels" of the images merton1, and
    the rendered scenes (--rendered).
    """

    # Standard deviations of the levels of one surface between views. By hand.
    agreement_scales: tuple[float, float, float] = (0.5, 2.0, 6.0)
    # Prior shares of the pairs of agreement of both sides: the three scales above and "not at all",
    # see `SIDE_COMPONENTS`. By hand; EM replaces them.
    prior_shares: tuple[float, ...] = (0.3, 0.15, 0.05, 0.15, 0.1, 0.04, 0.08, 0.03, 0.04, 0.06)
    # Percentiles of all levels that define 0 and 100. By hand.
    percentiles: tuple[float, float] = (2.0, 98.0)
    # Bin width of the histogram of clutter's levels, and share of clutter with a uniform level. By
    # hand.
    bin_width: float = 2.0
    any_level_share: float = 0.05
    # The local density of levels is that of this number of neighbours. By hand.
    neighbours: int = 25


@dataclass(frozen=True)
class EndTuning:
    """Tuned constants of the evidence of segment ends, along their common line.

    Their effect is visible in benchmarks/matching.py: rows "ej5" with ends cut by up to 5 px,
    merton1 and merton2. The scales are compiled into the programs.
    """

    # Standard deviations of the ends if all views agree, px. From the prototype, where the evidence
    # of ends was the largest single gain.
    agreement_px: tuple[float, float, float, float] = (0.7, 2.0, 5.0, 12.0)
    # The same if two views agree and the third stops short or runs on, px. By hand.
    pair_px: tuple[float, float, float] = (0.7, 2.0, 5.0)
    # Prior shares: all agree, by scale; the third stops short, by scale; it runs on, by scale; none
    # agree. By hand; EM replaces them.
    prior_shares: tuple[float, ...] = (
        *(0.35, 0.2, 0.08, 0.05),
        *(0.08, 0.05, 0.04),
        *(0.04, 0.03, 0.03),
        0.05,
    )


@dataclass(frozen=True)
class EvidenceTuning:
    """Tuned constants for the sum of all evidence as log odds.

    Their effect is visible in benchmarks/matching.py: calibration error and reliability table.
    """

    # Real errors have heavy tails: each is the stated one times one of these factors. From the
    # prototype (0.3 to 2), widened by hand to allow for wrong sigmas.
    tail_scales: tuple[float, ...] = (0.2, 0.6, 1.0, 2.0, 4.0)
    # Prior share of each factor. By hand; EM replaces them.
    prior_tail: tuple[float, ...] = (0.05, 0.25, 0.5, 0.15, 0.05)
    # Number of observations that the prior shares count as, and smallest share. By hand.
    prior_observations: int = 10
    min_share: float = 1e-3
    # Smallest thickness of the box of lines, as a share of its longest side, so that a planar scene
    # has a volume. By hand. The box of the line map uses it too.
    min_thickness_share: float = 0.05
    # Distance from the middle of the box to its corners, in standard deviations, and largest
    # penalty for a line outside, twice in log density. By hand.
    box_corner_sigmas: float = 3.0
    box_cost: float = 100.0
    # Added to the log odds of every triple, so that posteriors equal the share of right ones.
    # Fitted to the reliability table on simulated scenes with other seeds than the benchmark's.
    log_odds_offset: float = 1.0
    # Factor of the log odds of segments with side levels, which come from images. Clutter of
    # simulated scenes is independent. In images its pieces lie along one shadow or round one body,
    # and summed log odds are five times too large. Fitted on twelve rendered scenes (seeds 0 to 5
    # and 12 to 17), for triples and pairs alike.
    temperature: float = 0.2
    # Candidates with a smaller posterior are ignored by EM. By hand.
    negligible_posterior: float = 1e-3
    # Probability that a segment's polarity differs from that of its line: a background that differs
    # between views, or a wrong sign. Measured: 96.7 % of partners in real images agree.
    reversed_share: float = 0.017
    # Heavy tail of the errors of lines in space: factor of the sigma, and share of cases. By hand.
    outlier_sigmas: float = 3.0
    outlier_share: float = 0.15
