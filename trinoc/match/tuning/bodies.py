"""Tuned constants of rims, cylinders and shadows."""

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


@dataclass(frozen=True)
class ShadowTuning:
    """From tracks to shadow boundaries and their lamp. Shown by benchmarks/shadows.py."""

    # Among more lines than these some agree on a lamp by chance, as on photographs of buildings: no
    # lamp is looked for. Measured scenes have half as many. By hand.
    most_lines: int = 150
    # Lines of a plane, at least; a line lies in it within so many sigmas and this share of the
    # median length of lines. Lines less turned than this sine suggest no plane, and leave none; nor
    # are three of less volume the corner of a body. Pairs of lines are coplanar within as many
    # sigmas. By hand.
    fewest_in_plane: int = 4
    plane_sigmas: float = 3.0
    flatness: float = 0.015
    least_sine: float = 0.2
    # Levels beside lines are the same within this share; the usual log ratio of both sides.
    level_sigma: float = 0.08
    usual_ratio: float = 0.7
    # Lamps are looked for as far as this from the plane and from its normal, deg: lower ones graze,
    # and one straight above casts a body on its own foot. By hand: at 0 grazing ones win.
    margin_deg: float = 10.0
    # Steps of the coarse search, deg. By hand.
    coarse_deg: float = 4.0
    # Lamps are no nearer than this many sizes of the scene, as a reciprocal. By hand.
    nearest: float = 0.1
    # What is left of an edge that ends too early, as a share of the scene's size. By hand.
    room: float = 0.06
    # Share of shadows whose edge is not among the lines. By hand.
    unexplained: float = 0.25
    # Log odds of a shadow where there is a lamp, before it is known: a constant, then by what
    # `evidence_of_surroundings` counts; and where there is none. Log odds that the lamp is the true
    # one: a constant and by its score. Fitted to 36 rendered scenes of sharp shadows, 12 of soft
    # ones and 6 of none; the last by hand.
    log_odds: tuple[float, ...] = (-2.0, -1.9, -1.4, 1.4, 2.4)
    log_odds_without: float = -2.4
    log_odds_of_lamp: tuple[float, float] = (-10.0, 0.42)
    # Added to grey levels before their logarithm is taken: a black level tells little. By hand.
    dark_level: float = 4.0
