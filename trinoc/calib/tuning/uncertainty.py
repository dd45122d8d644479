"""Tuned constants of what is known before a picture is taken."""

from dataclasses import dataclass


@dataclass(frozen=True)
class UncertaintyTuning:
    """What is assumed of sheet, aim and lens where nobody says it: see `Systematics.typical`. All
    standard deviations by hand; shown by the coverage of benchmarks/calibration_conditions.py."""

    # Of the whole print's size, and of each side beside that, as shares.
    print_size: float = 2e-3
    print_stretch: float = 7e-4
    # Of a sheet's height at its edge, and of the point that a camera is aimed at, mm.
    flatness_mm: float = 0.3
    aim_mm: float = 20.0
    # Of a data sheet: focal length, its aspect, the principal point over the picture's width, and
    # distortion at the corner, px.
    focal_length: float = 1e-2
    aspect: float = 2e-3
    principal_point: float = 2e-2
    distortion_px: float = 1.0
