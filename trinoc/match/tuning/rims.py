"""Tuned constants of rims."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RimTuning:
    """Tuned constants of the search for circles through chords.

    Their effect is visible in benchmarks/rims.py.
    """

    # Two matched lines propose a circle if the two tangent circles coincide within this share of
    # the radius. Other lines support it within half of that. By hand.
    closure_share: float = 0.2
    # A line follows a circle if its direction differs from the tangent by less than this, degrees.
    # Two lines that propose a circle differ by more. By hand.
    tangent_deg: float = 15.0
    # Largest distance of a chord from its circle, px; twice that before the fit and at the middle
    # of the chord. By hand: detectors allow less, but half of this loses one rim of 13.
    touch_px: float = 1.0
    # Smallest ratio of the axes of a circle's image in a view whose chords count, because a row of
    # bricks lies on many narrow ellipses. By hand: 18 wrong circles on photographs of Merton
    # College have less than 0.08 in all views, the rims of seeds 0 to 11 more than 0.6.
    min_axis_ratio: float = 0.15
    # A circle is accepted if this number of chords touches it in each of two views, and two views
    # show this share of it: half before the fit, twice if no third view has chords. By hand, on
    # seeds 0 to 11 and the demo: wrong circles had shares of 0.10 to 0.25.
    min_chords: int = 3
    min_covered_share: float = 0.28
    # Posterior of accepted circles and of outline tracks. None of 23 circles and 10 tracks on these
    # scenes was wrong; with one more of each kind it would be 0.97.
    posterior: float = 0.95
    # Standard deviation of a piece's ends along the rim, px, where detectors cut an arc. Shorter
    # pieces are discarded. By hand.
    end_px: float = 1.0
