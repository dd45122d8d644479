"""What a circle fit tells its user, in sentences."""

from collections.abc import Mapping

import numpy as np

from trinoc.calib.detection import Detection
from trinoc.calib.photometric import ViewEstimate
from trinoc.calib.pose import PoseEstimate
from trinoc.calib.result import Alternative, CameraFit, Status
from trinoc.calib.targets import Pattern
from trinoc.geometry import Intrinsics, PoseModel

# Centres of the right sheet through the right lens fit to hundredths of a pixel; beyond this
# share of the sheet's size in the picture the model is not the camera's.
_LARGEST_MISFIT = 0.01
_SMALLEST_MISFIT_PX = 1.0
_LARGE_CHI_SQUARE = 2.0
_CUT_SHARE = 0.01
# A lens may be off by this many of its own sigmas.
_EXPLAINED_SIGMAS = 3.0


def failure_sentence(fit: PoseEstimate, detection: Detection, model: PoseModel) -> str | None:
    """Why the pose must not be used and what to do next, or None where it may be."""
    if fit.status is Status.RANK_DEFICIENT:
        free = ", ".join(fit.gauge)
        return (
            f"{len(detection)} circles leave {free} free: show more of the sheet, or circles "
            "that do not lie on one line."
        )
    if fit.status is not Status.CONVERGED:
        return (
            f"the fit to its {len(detection)} circles did not converge: check that the pattern "
            "and the lens are those of this picture."
        )
    misfit_px = float(np.sqrt(np.mean(np.sum(fit.residuals_px[fit.used] ** 2, axis=1))))
    extent_px = float(np.max(np.ptp(detection.centres_px, axis=0)))
    if misfit_px > max(_SMALLEST_MISFIT_PX, _LARGEST_MISFIT * extent_px):
        free = "" if model is PoseModel.AIM_FREE else ", or free the aim with parameters=6"
        return (
            f"the circles miss their predicted places by {misfit_px:.1f} px: check the focal "
            f"length and the pattern{free}."
        )
    if 2 * int(fit.used.sum()) < len(fit.used):
        return (
            f"only {int(fit.used.sum())} of {len(fit.used)} circles agree on one camera: check "
            "the pattern and the picture."
        )
    return None


def is_suspect(fit: CameraFit, lens: Intrinsics, lens_sigmas: Mapping[str, float] | None) -> bool:
    """Whether something that the model leaves out shows beyond what its sigmas can carry.

    lens_sigmas : of the lens's parameters by name, where the covariance holds the lens's; what
        these explain is no reason for suspicion.
    """
    if not (fit.alternatives and fit.alternatives[0].found):
        return False
    if not fit.reduced_chi_square > _LARGE_CHI_SQUARE:
        return False
    first = fit.alternatives[0]
    if lens_sigmas is None or first.name == "aim":
        return True
    by_name = {
        "focal length": lens_sigmas.get("fx_px", 0.0) / float(lens.focal_length_px[0]),
        "radial distortion": lens_sigmas.get("k1", 0.0),
    }
    return bool(abs(first.estimate[0]) > _EXPLAINED_SIGMAS * by_name[first.name])


def notes_of_fit(
    refined: ViewEstimate,
    detection: Detection,
    pattern: Pattern,
    alternatives: tuple[Alternative, ...],
) -> tuple[str, ...]:
    """Sentences on what a user of a good fit should know."""
    fit, quality = refined.fit, refined.quality
    notes = [] if refined.note is None else [f"{refined.note} Its circles alone were used."]
    if alternatives and alternatives[0].found:
        notes.insert(0, alternatives[0].sentence)
    dropped = detection.circle_index[~fit.used]
    if len(dropped):
        notes.append(
            f"{len(dropped)} circle{'s were' if len(dropped) > 1 else ' was'} located wrongly and "
            f"left out: {', '.join(str(k) for k in dropped)}."
        )
    if len(detection) < len(pattern):
        notes.append(f"{len(detection)} of {len(pattern)} circles were found.")
    if fit.status is Status.CONVERGED and fit.gauge:
        notes.append(f"{' and '.join(fit.gauge)} are not determined one by one.")
    if quality is not None and quality.pixels_cut > _CUT_SHARE * quality.pixels:
        share = quality.pixels_cut / (quality.pixels + quality.pixels_cut)
        notes.append(
            f"{100 * share:.0f} % of the pixels near the sheet's edges show something else and "
            "were left out."
        )
    if quality is not None and quality.reduced_chi_square > _LARGE_CHI_SQUARE:
        notes.append(
            f"the picture departs from the model by {quality.noise:.1f} grey levels, where its "
            f"own noise is {quality.noise_floor:.1f}: expect errors beyond the sigmas."
        )
    if quality is None and fit.reduced_chi_square > _LARGE_CHI_SQUARE:
        notes.append(
            f"the circles scatter {np.sqrt(fit.reduced_chi_square):.1f} times as much as their "
            "own sigmas say; the parameters' sigmas are enlarged by that factor."
        )
    return tuple(notes)
