"""Tuned constants of rims, cylinders and shadows."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RimTuning:
    """From chords to circles. Shown by benchmarks/guided.py."""

    # Two matched lines suggest a circle where they turn by this, degrees, at least, and where what
    # touches both closes within so many px, and share of its radius, of the usual picture. By hand.
    least_turn_deg: float = 17.0
    closes_px: float = 5.0
    closes_share: float = 0.2
    # Of each line so many nearest others are tried with it, and so many circles in all are looked
    # for in the pictures, those of most support: measured scenes have fewer of both.
    neighbours: int = 150
    most_circles: int = 1500
    # Radii, px of the usual picture. By hand.
    radii_px: tuple[float, float] = (4.0, 200.0)
    # Other matched lines speak for a circle that are this near, px and share of the radius, and
    # whose direction differs by this from its tangent and plane, degrees; of each line so many
    # circles of most support are looked at in the pictures. By hand.
    near_px: float = 3.0
    near_share: float = 0.05
    alike_deg: float = 20.0
    most_of_line: int = 6
    # A chord touches a circle within so many px, first and last, in a direction that differs by
    # this, degrees, and bows no further off it than this, px: more than detectors let pass. By
    # hand.
    first_px: float = 2.0
    last_px: float = 1.0
    tangent_deg: float = 12.0
    most_bow_px: float = 2.0
    # Chords speak for a circle in views whose image of it has more than this, its shorter over its
    # longer axis: a row of bricks lies on many a narrow ellipse. By hand: 18 wrong circles on
    # photographs of Merton College have less than .08 in all views, the rims of seeds 0 to 11
    # more than .6.
    least_axis_ratio: float = 0.15
    # Beyond what segments claim, a chord's two places on its arc are off by this, px: where arcs
    # are cut, their ends bend. By hand.
    floor_px: float = 0.15
    # A circle is put out where so many chords touch it in each of two views and two views show
    # this share of it. By hand, on seeds 0 to 11 and the demo: wrong ones showed .10 to .25.
    least_chords: int = 3
    least_covered: float = 0.28
    # The same before it is fitted. By hand.
    least_covered_at_first: float = 0.15
    # The same where all chords are of two views. By hand.
    least_covered_of_two: float = 0.5
    # Of the 23 that were put out on these, none was wrong: one more of each kind.
    posterior: float = 0.96
    # The same where no third view has chords. By hand.
    posterior_of_two: float = 0.9
    # Such a rim is dropped where other chords of one view fit as well, by their length: this share.
    # By hand, on photographs of a plate of 100 equal circles.
    rival_share: float = 0.5
    # Pieces of a rim are at most this long, rad, and at least this, px. By hand.
    longest_piece_rad: float = 0.7
    shortest_piece_px: float = 1.5
    # A track shows the outline of the body below a rim where two of its segments have ends that
    # touch that cylinder within this, px, one of them this near to the rim, as a share of its
    # radius, and neither further away along the axis than so many radii. By hand. Of 10 such tracks
    # on seeds 0 to 11 none was an edge; of those with one such segment 6 of 11 were.
    outline_px: float = 1.5
    outline_from: float = 0.4
    outline_to: float = 4.0
    outline_posterior: float = 0.92
    # Residuals of so many standard deviations have half the weight. By hand.
    robust_sigmas: float = 3.0
    # Standard deviation of a piece's ends along the rim, px: where detectors cut an arc. By hand.
    end_px: float = 1.0


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


@dataclass(frozen=True)
class ShadowTuning:
    """From tracks to shadow boundaries and their lamp. Shown by benchmarks/shadows.py."""

    # Among more lines than these some agree on a lamp by chance, as on photographs of buildings:
    # no lamp is looked for. Measured scenes have half as many. By hand; and what is stated then.
    most_lines: int = 150
    share_unknown: float = 0.06
    # Lines of a plane, at least; a line lies in it within so many sigmas and this share of the
    # median length of lines. Lines less turned than this sine suggest no plane. By hand.
    fewest_in_plane: int = 4
    plane_sigmas: float = 3.0
    flatness: float = 0.015
    least_sine: float = 0.2
    # A line of this sine against a plane leaves it; three lines of this volume of their unit
    # vectors are the corner of a body. By hand.
    leaving_sine: float = 0.25
    body_volume: float = 0.15
    # Levels beside lines are the same within this share; the usual log ratio of both sides.
    level_sigma: float = 0.08
    usual_ratio: float = 0.7
    # Lamps are looked for this high above the plane, middle and to both sides of it, deg: lower
    # ones graze, and one straight above casts a body on its own foot. By hand.
    middle_deg: float = 48.0
    reach_deg: float = 36.0
    # Steps of the coarse search, deg; lamps that are pursued; what counts as another lamp, deg; how
    # sharp the last search is, deg. By hand.
    coarse_deg: float = 4.0
    peaks: int = 10
    apart_deg: float = 8.0
    fine_deg: float = 0.4
    # Lamps are no nearer than this many sizes of the scene, as a reciprocal. By hand.
    nearest: float = 0.1
    # Shares of the scene's size: the error that every line has, what is left of an edge that ends
    # too early, and how far behind its edge a shadow must lie. By hand.
    floor: float = 0.001
    room: float = 0.06
    least_gap: float = 0.05
    # Pairs of lines are coplanar up to this chi-square (1 degree of freedom).
    coplanar_chi_square: float = 9.0
    # Share of shadows whose edge is not among the lines. By hand.
    unexplained: float = 0.25
    # Log odds of a shadow: a constant, then by what `evidence_of_surroundings` counts; with a lamp
    # also by the log likelihood of the edge that casts it. Log odds that the lamp is the true one:
    # a constant, by its score and by its lead over the next. Fitted to 36 rendered scenes of sharp
    # shadows, 12 of soft ones and 6 of none; the last made steeper by hand.
    first_log_odds: tuple[float, ...] = (-2.0, -1.9, -1.4, 1.4, 2.4)
    log_odds_without: tuple[float, ...] = (-2.4, -0.9, -0.6, -0.9, -0.5)
    log_odds_with: tuple[float, ...] = (-1.5, -1.3, -1.6, 1.1, 2.5, 0.75)
    log_odds_of_lamp: tuple[float, ...] = (-10.0, 0.36, 0.06)
    # Added to grey levels before their logarithm is taken: a black level tells little. By hand.
    dark_level: float = 4.0
