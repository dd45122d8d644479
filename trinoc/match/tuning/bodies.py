"""Tuned constants of rims and cylinders."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RimTuning:
    """From chords to circles. Shown by benchmarks/bodies.py."""

    # Two matched lines suggest a circle where what touches both closes within this share of its
    # radius; others speak for it within half of that. By hand.
    closes_share: float = 0.2
    # Directions are those of a circle where they differ from its tangent by less than this,
    # degrees; those of two lines that suggest one differ by more. By hand.
    tangent_deg: float = 15.0
    # A chord touches a circle within so many px, and twice as many before it is fitted and at its
    # middle: more than detectors let pass. By hand: at half of it a rim of 13 is lost.
    touch_px: float = 1.0
    # Chords speak for a circle in views whose image of it has more than this, its shorter over its
    # longer axis: a row of bricks lies on many a narrow ellipse. By hand: 18 wrong circles on
    # photographs of Merton College have less than .08 in all views, the rims of seeds 0 to 11 more
    # than .6.
    least_axis_ratio: float = 0.15
    # A circle is put out where so many chords touch it in each of two views and two views show this
    # share of it, half of that before it is fitted, twice where no third view has chords. By hand,
    # on seeds 0 to 11 and the demo: wrong ones showed .10 to .25.
    least_chords: int = 3
    least_covered: float = 0.28
    # Of the 23 that were put out on these, and of 10 tracks of outlines below them, none was wrong:
    # one more of each kind would be .97.
    posterior: float = 0.95
    # Standard deviation of a piece's ends along the rim, px: where detectors cut an arc; shorter
    # pieces are none. By hand.
    end_px: float = 1.0


@dataclass(frozen=True)
class CylinderTuning:
    """From outlines to cylinders, with the errors and the significance of `CollinearTuning`. Shown
    by benchmarks/cylinders.py."""

    # Segments of a track in three views above this posterior, which does not move with the
    # viewpoint, are no outlines; nor are shorter ones, px. By hand.
    certain_posterior: float = 0.97
    shortest_px: float = 8.0
    # Standard deviation by which an outline's ends are off where it bends into a rim, px.
    rim_px: float = 0.3
    # Both outlines of a view are as parallel as this, deg, and so wide apart, px. Segments this
    # nearly parallel to an axis, deg, are as likely to be there as its outlines. By hand: without
    # the last two edges of boxes make a cylinder.
    parallel_deg: float = 12.0
    narrowest_px: float = 4.0
    common_deg: float = 3.0
    # A cylinder is determined where the standard deviations of its place and radius are below this
    # share of the radius, and that of its direction below as much, rad. By hand.
    largest_doubt: float = 0.5
    # Lines of a scene for each cylinder, and the share of outlines that have a segment, as assumed
    # before any is seen.
    prior_lines: float = 100.0
    shown_share: float = 0.7
