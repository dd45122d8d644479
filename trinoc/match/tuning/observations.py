"""Tuned constants of what is prepared: clutter, and grey levels beside segments."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ClutterTuning:
    """What segments that belong to nothing look like. Shown by merton1 and merton2, where texture
    is dense in places, and by the fresh scenes (benchmarks/matching.py)."""

    # Clutter is as dense about a segment as so many of its neighbours are. By hand.
    neighbours: int = 25


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
