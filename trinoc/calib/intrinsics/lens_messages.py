"""What the fit of a lens tells its user, in sentences."""

import numpy as np

from trinoc.calib.intrinsics.lens_fit import LensFit
from trinoc.calib.intrinsics.lens_parameters import LensModel
from trinoc.calib.intrinsics.robust_lens import LensImages
from trinoc.geometry import AbstractLens

# A sheet tilted by less hardly shortens: focal length and distance look alike.
_SQUARE_DEG = 8.0
# Tilts about axes this close are tilts about one axis.
_ONE_AXIS_DEG = 12.0
# Distortion is extrapolated beyond the circles; further than this share of the way to the
# corners it is still held by them.
_ENOUGH_REACH = 0.8
# Misfits of flat sheets through lenses of this kind stay below this share of the sheet's extent.
_LARGEST_MISFIT = 0.003
_SMALLEST_MISFIT_PX = 1.0


def undetermined_sentence(gauge: tuple[str, ...], fit: LensFit, model: LensModel) -> str:
    """Which parameters the pictures cannot determine, and why where that is plain."""
    names = ", ".join(name for name in model.free if name in gauge)
    return f"The pictures do not determine {names}{_reason(fit)}."


def not_converged_sentence(fit: LensFit) -> str:
    """That there is no result, and why where that is plain."""
    return f"The fit did not converge, so that nothing of the lens is determined{_reason(fit)}."


def _reason(fit: LensFit) -> str:
    facing = np.asarray(fit.cam_from_world)[:, :3, 2]
    tilts = np.degrees(np.arctan2(np.hypot(facing[:, 0], facing[:, 1]), np.abs(facing[:, 2])))
    if (tilts < _SQUARE_DEG).all():
        return (
            ": all of them show the sheet square to the camera, where a longer focal length and "
            "a larger distance look the same"
        )
    if len(facing) == 1:
        return ": one picture of a plane tells two numbers of a lens and no more"
    tilted = facing[tilts >= _SQUARE_DEG, :2]
    doubled = 2.0 * np.arctan2(tilted[:, 1], tilted[:, 0])
    alignment = np.hypot(np.mean(np.cos(doubled)), np.mean(np.sin(doubled)))
    if alignment > np.cos(np.radians(2.0 * _ONE_AXIS_DEG)):
        return ": the sheet is tilted about one axis only"
    return ""


def misfit_sentence(fit: LensFit, images: LensImages) -> str | None:
    """Why the lens must not be used although the fit ended, or None where it may be."""
    total = sum(len(used) for used in images.used)
    kept = sum(int(used.sum()) for used in images.used)
    if 2 * kept < total:
        return (
            f"Only {kept} of {total} circles agree on one lens: check that all pictures show this "
            "pattern and were taken by one camera at one zoom and focus."
        )
    errors = np.concatenate(
        [fit.residuals_px[k, : len(used)][used] for k, used in enumerate(images.used) if used.any()]
    )
    misfit_px = float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
    extent_px = np.median([np.ptp(each.centres_px, axis=0).max() for each in images.detections])
    if misfit_px > max(_SMALLEST_MISFIT_PX, _LARGEST_MISFIT * float(extent_px)):
        return (
            f"The circles miss their predicted places by {misfit_px:.1f} px: check that all "
            "pictures show this pattern and were taken by one camera at one zoom and focus."
        )
    return None


def notes_of_lens(
    lens: AbstractLens,
    images: LensImages,
    model: LensModel,
    reduced_chi_square: float,
    image_index: tuple[int, ...],
) -> tuple[str, ...]:
    """Sentences on what a user of a lens should know."""
    notes = []
    for index, used in zip(image_index, images.used, strict=True):
        wrong = int((~used).sum())
        if wrong:
            notes.append(
                f"Picture {index + 1}: {wrong} of {len(used)} circles {_were(wrong)} located "
                "wrongly and left out."
            )
    if reduced_chi_square > 2.0:
        notes.append(
            f"The circles scatter {np.sqrt(reduced_chi_square):.1f} times as much as their own "
            "sigmas say; the parameters' sigmas are enlarged by that factor. See that the sheet "
            "is flat and that all pictures were taken at one zoom and focus."
        )
    share = reach(lens, images)
    if model.distortion and share < _ENOUGH_REACH:
        notes.append(
            f"No circle lies further than {100 * share:.0f} % of the way from the principal point "
            "to the corners: the distortion beyond is extrapolated."
        )
    return tuple(notes)


def reach(lens: AbstractLens, images: LensImages) -> float:
    """How far circles lie from the principal point, as a share of the farthest corner."""
    middle = np.asarray(lens.principal_point_px)
    width, height = images.image_size_px
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
    farthest = np.linalg.norm(corners - middle, axis=1).max()
    circles = np.concatenate([detection.centres_px for detection in images.detections])
    return float(np.linalg.norm(circles - middle, axis=1).max() / farthest)


def _were(count: int) -> str:
    return "was" if count == 1 else "were"
