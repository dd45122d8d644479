"""Tuned constants of the room that asks whether a camera was knocked."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RigCheckTuning:
    """A calibration against an earlier one, and a rig against scene pictures. Shown by the
    knocked rigs of benchmarks/refine_matched.py."""

    # A camera has moved since an earlier calibration beyond so many sigmas: once in 10^5
    # comparisons of it by noise alone. By hand.
    moved_sigmas: float = 4.5
    # Where neither rig has sigmas, changes up to these say nothing. By hand.
    quiet_mm: float = 0.1
    quiet_deg: float = 0.01
    # Pictures were swapped when the other camera's place fits so many times better. By hand.
    swap_ratio: float = 10.0
    # Below so many sigmas a motion of scene pictures may be chance: of three cameras that stand
    # still, one rig in 120 is suspected. By hand.
    suspect_sigmas: float = 3.0
    # Fewer lines are hardly enough for the six numbers of a camera. By hand.
    fewest_lines: int = 12
    # Lines that scatter more than so many stated sigmas are joined by chance: such scatter 1.2 to
    # 2.3 times, right ones 0.9 to 1.1. Only where nothing can be matched again. Made scenes.
    most_noise: float = 1.5
