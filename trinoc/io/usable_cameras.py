"""Lenses and rigs that no camera and no rig can be, refused before anything is computed."""

from collections.abc import Mapping

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.geometry.rig import at_one_place

# Focal length over the longer side of the picture: from nearly 180 degrees to a large telescope.
FOCAL_RANGE = (1e-3, 1e5)
# A pixel has a few micrometres; of some detectors for X-rays it has a fifth of a millimetre.
PITCH_RANGE_MM = (1e-4, 0.5)


def expect_lens(lens: Intrinsics, where: str) -> Intrinsics:
    """The lens itself; `where` begins the sentence of the InputError for one that cannot be.

    Refused are pixels and focal lengths of impossible size, and a distortion that folds the
    picture: beyond the fold two rays meet one pixel, and none meets the pixels farther out.
    """
    expect_pitch(lens.pixel_pitch_mm, f"{where} has pixels of")
    focal_px, side_px = np.asarray(lens.focal_length_px), max(lens.image_size_px)
    low, high = (factor * side_px for factor in FOCAL_RANGE)
    if not ((focal_px >= low) & (focal_px <= high)).all():
        raise InputError(
            f"{where} has a focal length of {focal_px[0]:.4g} x {focal_px[1]:.4g} px for pictures "
            f"{side_px} px wide, which no lens has: check the numbers and their units."
        )
    fold_px = lens.lens.fold_radius_px()
    width, height = lens.image_size_px
    corners = np.array([(u, v) for u in (0, width - 1) for v in (0, height - 1)], dtype=float)
    centre_px = np.asarray(lens.principal_point_px)
    if not (np.abs(centre_px) <= FOCAL_RANGE[1] * side_px).all():
        raise InputError(
            f"{where} has its principal point at {centre_px[0]:.4g}, {centre_px[1]:.4g} px, where "
            "no lens has it: check the numbers and their units."
        )
    corner_px = np.linalg.norm(corners - centre_px, axis=1).max()
    if fold_px < corner_px:
        raise InputError(
            f"{where} has a distortion that folds the picture {fold_px:.0f} px from the principal "
            f"point, where corners lie {corner_px:.0f} px away: check the coefficients, their "
            "order and signs, or fit fewer of them."
        )
    if isinstance(lens.lens, AbstractSplinedLens) and not lens.lens.steepness() < 1.0:
        raise InputError(
            f"{where} has a correction that folds the picture: neighbouring control points differ "
            f"by {lens.lens.steepness():.2g} times their distance. Check their order and unit (px)."
        )
    return lens


def expect_pitch(pitch_mm: tuple[float, float] | None, where: str) -> None:
    """Raise InputError for a pixel pitch in another unit than mm."""
    if pitch_mm is None or all(PITCH_RANGE_MM[0] <= side <= PITCH_RANGE_MM[1] for side in pitch_mm):
        return
    said = f"{where} {pitch_mm[0]:g} {pitch_mm[1]:g} mm"
    factor, unit = (1e-3, "micrometres") if max(pitch_mm) > PITCH_RANGE_MM[1] else (1e3, "metres")
    in_mm = [side * factor for side in pitch_mm]
    if all(PITCH_RANGE_MM[0] <= side <= PITCH_RANGE_MM[1] for side in in_mm):
        raise InputError(
            f"{said}, which looks like {unit}: write {in_mm[0]:g} {in_mm[1]:g} millimetres."
        )
    raise InputError(f"{said}, which no pixel has: give its width and height in millimetres.")


def expect_apart(cameras: Mapping[str, Camera], where: str) -> None:
    """Raise InputError where two cameras stand at one place: nothing between them has a depth."""
    pair = at_one_place(cameras)
    if pair is not None:
        raise InputError(
            f'{where}: the cameras "{pair[0]}" and "{pair[1]}" stand at one place, which leaves '
            "depth unknown: calibrate them again, or remove one."
        )
