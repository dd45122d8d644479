"""Tuned constants of rims."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RimTuning:
    """From chords to circles. Shown by benchmarks/rims.py."""

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
