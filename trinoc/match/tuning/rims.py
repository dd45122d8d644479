"""Tuned constants of rims."""

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
