"""Tuned constants of the adjustment of all cameras over one sheet."""

from dataclasses import dataclass


@dataclass(frozen=True)
class AdjustmentTuning:
    """Which answer of a picture is believed. Shown by benchmarks/picture_conditions.py."""

    # A camera is started another way where half of its circles lie farther off, in sigmas. By hand.
    far_sigmas: float = 10.0
    # The difference of two answers has at least this share of the circles' covariance. By hand.
    least_difference: float = 0.1
    # Blocks along each side of the sheet that are left out in turn, and the fewest with circles
    # that tell how blocks scatter. By hand.
    blocks: int = 4
    fewest_blocks: int = 6
