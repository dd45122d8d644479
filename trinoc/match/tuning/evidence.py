"""Tuned constants of the evidence: where segments end, heavy tails, polarity, what is learned.

Tuned constants of what is prepared: clutter, and grey levels beside segments.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ClutterTuning:
    """What segments that belong to nothing look like. Shown by merton1 and merton2, where texture
    is dense in places, and by the fresh scenes (benchmarks/matching.py)."""

    # Clutter is as dense about a segment as so many of its neighbours are. By hand.
    neighbours: int = 25


@dataclass(frozen=True)
class ObservationTuning:
    """Segments that say nothing. Shown by no row: a saturated edge may state any error."""

    # A segment is left out whose standard deviation across itself is larger than this, px, or than
    # its own length. By hand: twice what the widest blurred edges of photographs state.
    largest_across_px: float = 8.0
    # Segments of one view are one whose ends agree within this share of the standard deviation
    # across. By hand.
    equal_sigmas: float = 0.25


@dataclass(frozen=True)
class SideTuning:
    """Grey levels beside segments, in hundredths of the range of all levels. Shown by "with side
    levels" of merton1 and by the rendered scenes (benchmarks/matching.py --rendered)."""

    # Standard deviations with which the levels of one surface agree between views. By hand.
    agreeing: tuple[float, float, float] = (0.5, 2.0, 6.0)
    # Shares, before anything is learned, of how the one side agrees and how the other: pairs of
    # the three above and of "not at all", see `SIDE_COMPONENTS`. By hand; EM replaces them.
    prior_shares: tuple[float, ...] = (0.3, 0.15, 0.05, 0.15, 0.1, 0.04, 0.08, 0.03, 0.04, 0.06)
    # Percentiles of all levels that are 0 and 100. By hand.
    percentiles: tuple[float, float] = (2.0, 98.0)
    # Width of a bin of the histogram of clutter's levels, and the share of clutter that has any
    # level. By hand.
    bin_width: float = 2.0
    any_level_share: float = 0.05
    # Levels are as usual about a segment as among so many neighbours. By hand.
    neighbours: int = 25


@dataclass(frozen=True)
class EndTuning:
    """Where segments end along their line. Shown by the rows "ej5", ends cut by up to 5 px, and by
    merton1 and merton2 (benchmarks/matching.py). The scales are static in the kernels."""

    # Standard deviations with which the ends of all views agree, px. From the prototype, where
    # evidence of ends was the largest single gain.
    agreeing_px: tuple[float, float, float, float] = (0.7, 2.0, 5.0, 12.0)
    # The same where two views agree and the third stops short or runs on, px. By hand.
    pair_px: tuple[float, float, float] = (0.7, 2.0, 5.0)
    # Shares before anything is learned: all agree, by scale; the third stops short, by scale; it
    # runs on, by scale; none agree. By hand; EM replaces them.
    prior_shares: tuple[float, ...] = (
        *(0.35, 0.2, 0.08, 0.05),
        *(0.08, 0.05, 0.04),
        *(0.04, 0.03, 0.03),
        0.05,
    )


@dataclass(frozen=True)
class EvidenceTuning:
    """How evidence adds up to log odds. Shown by the calibration error and the reliability table
    (benchmarks/matching.py)."""

    # Real segments have heavy tails: their error is the stated one times one of these. From the
    # prototype (0.3 to 2), widened by hand so that wrong sigmas are made good.
    tail_scales: tuple[float, ...] = (0.2, 0.6, 1.0, 2.0, 4.0)
    # Share of each before anything is learned. By hand; EM replaces them.
    prior_tail: tuple[float, ...] = (0.05, 0.25, 0.5, 0.15, 0.05)
    # Prior shares count as so many observations; no share falls below the least. By hand.
    prior_observations: int = 10
    min_share: float = 1e-3
    # Least thickness of the box that holds the lines, as a share of its longest side, so that
    # lines of one plane leave a volume. By hand. The line map's box has the same.
    thinnest: float = 0.05
    # Standard deviations from the middle of the box to its corners, and the most that lying
    # outside costs, twice in log density. By hand.
    box_corner_sigmas: float = 3.0
    box_cost: float = 100.0
    # Added to the log odds of every triple, so that posteriors match the share that is right:
    # fitted on made scenes of other seeds than the benchmark's, by the reliability table.
    log_odds_offset: float = 1.0
    # Clutter of made scenes is independent; in pictures its pieces lie along one shadow or round
    # one body, and summed log odds are five times too high. Log odds of segments with known side
    # levels, which is to say from pictures, are multiplied by this: fitted on twelve rendered
    # scenes (seeds 0 to 5 and 12 to 17), for triples and for pairs alike.
    temperature: float = 0.2
    # Candidates less likely than this teach nothing. By hand.
    negligible: float = 1e-3
    # How often a segment's known darker side is not that of its line: a background that differs
    # between views, or a wrong sign. Measured: of partners in real pictures, 96.7 % agree.
    turned_share: float = 0.017
    # Lines in space are as near their true places as their covariances say, or worse by this
    # factor in this share of cases. By hand.
    loose_sigmas: float = 3.0
    loose_share: float = 0.15
