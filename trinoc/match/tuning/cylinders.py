"""Tuned constants of cylinders."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CylinderTuning:
    """From outlines to cylinders. Shown by benchmarks/cylinders.py."""

    # Segments of a track in three views above this posterior, which does not move with the
    # viewpoint, are no outlines; nor are shorter ones, px. By hand.
    certain_posterior: float = 0.97
    shortest_px: float = 8.0
    # Standard deviation by which an outline's ends are off where it bends into a rim, px.
    rim_px: float = 0.3
    # Segments err by more than they say: by one of these factors, in so many cases.
    error_scales: tuple[float, float, float] = (1.0, 2.0, 5.0)
    error_shares: tuple[float, float, float] = (0.84, 0.12, 0.04)
    # Both outlines of a view are as parallel as this, deg, share this much of the shorter, and are
    # so wide apart, px and lengths of the longer. By hand.
    parallel_deg: float = 12.0
    abreast_share: float = 0.5
    narrowest_px: float = 4.0
    widest_lengths: float = 4.0
    # So many pairs of outlines of a view at most, those that share most. By hand, for time.
    most_pairs: int = 1000
    # So many hypotheses at most, those of the longest outlines. By hand, for memory.
    most_hypotheses: int = 40_000
    # The planes half-way between the outlines of two views meet at this angle or more, deg.
    least_turn_deg: float = 2.0
    # Further outlines are looked at within this share of the radius. By hand, for time.
    radius_share: float = 0.5
    # Segments this nearly parallel to an axis, deg, are as likely to be there as its outlines. By
    # hand.
    common_deg: float = 3.0
    # Outlines fit no worse than this share of true ones. Rounds in which outlines are added.
    significance: float = 1e-3
    rounds: int = 3
    # A cylinder is determined where the standard deviations of its place and radius are below this
    # share of the radius, and that of its direction below as much, rad. By hand.
    largest_doubt: float = 0.5
    # Cylinders and lines of a scene, and the share of outlines that have a segment, as assumed
    # before any is seen.
    prior_cylinders: float = 1.0
    prior_lines: float = 100.0
    shown_share: float = 0.7
    # Cylinders above this posterior are put out. By hand.
    least_posterior: float = 0.5
