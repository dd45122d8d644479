"""Tuned constants of cameras and lines refined together."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BundleTuning:
    """Which fragments are believed, and which of several answers. Shown by errors and coverage of
    benchmarks/refine.py, the last six by benchmarks/refine_matched.py."""

    # What a fragment can cost, as a distance in sigmas; and how many times wider the loss is, from
    # round to round: first everything speaks, then only what fits. By hand.
    loss_sigmas: float = 4.0
    widenings: tuple[float, ...] = (16.0, 4.0, 1.0)
    # Right fragments lie farther off than those that are kept with this probability. By hand.
    outlier_chance: float = 1e-3
    # With less redundancy the sheet's own claim is kept: a factor from it would be off by 13 % or
    # more. By hand.
    fewest_for_sheet: int = 30
    # The search starts with a camera turned by the largest knock that it is meant for, degrees, or,
    # if it aims at the origin, taken round it, where pictures of what lies near stay. By hand.
    turn_deg: float = 1.2
    round_deg: float = 5.0
    # A camera whose orientation the sheet knows to this share of `turn_deg` cannot stand
    # elsewhere. By hand.
    known_share: float = 0.25
    # Two answers are one where the lines of one miss each other by less with the other. By hand.
    same_sigmas: float = 3.5
    # An answer is clear where no other comes within this factor in log posterior: beside wrong ones
    # within 1.35 in 5 of 6, beside right ones none of 45 within 1.52. Made scenes, from 150,000 on.
    clear_factor: float = 1.45
