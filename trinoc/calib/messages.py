"""What a circle fit tells its user, in sentences."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.adjustment.agreement import autocorrelation_of_circles
from trinoc.calib.adjustment.each_camera import PoseEstimate
from trinoc.calib.adjustment.estimate import Adjustment
from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.result.calibration import Alternative, Status
from trinoc.calib.rig_fit import CameraChoice, Knowledge
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.intrinsics import (
    FOLD_REMEDY,
    Intrinsics,
    describe_fold,
    describe_unusable_fold,
)
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.tails import chi_square_tail, normal_limit

# numerical: rows of a lens.
_PRINCIPAL_POINT = slice(2, 4)


def failure_sentence(
    fit: PoseEstimate,
    detection: Detection,
    model: PoseModel,
    lens: Intrinsics,
    lens_factor: Float[np.ndarray, "_k _r"] | None = None,
) -> str | None:
    """Why the pose must not be used and what to do next, or None where it may be.

    lens_factor : (k, r) of the covariance of a lens that the fit took as exact.
    """
    if fit.status is Status.RANK_DEFICIENT:
        free = ", ".join(fit.gauge)
        return (
            f"{len(detection)} circles leave {free} free: show more of the sheet, or circles "
            "that do not lie on one line."
        )
    if fit.status is not Status.CONVERGED:
        return _with_fold(
            f"the fit to its {len(detection)} circles did not converge",
            detection,
            lens,
            "check that the pattern and the lens are those of this picture.",
        )
    misfit_px = float(np.sqrt(np.mean(np.sum(fit.residuals_px[fit.used] ** 2, axis=1))))
    extent_px = float(np.max(np.ptp(detection.centres_px, axis=0)))
    largest_px = max(TUNING.answer.least_misfit_px, TUNING.answer.misfit_share * extent_px)
    if lens_factor is not None:
        # With the aim held, a principal point that is off by so much moves every circle.
        largest_px += TUNING.answer.strain_sigmas * float(
            np.linalg.norm(lens_factor[_PRINCIPAL_POINT])
        )
    if misfit_px > largest_px:
        free = "" if model is PoseModel.AIM_FREE else ', or free the aim with pose_model="aim-free"'
        return _with_fold(
            f"the circles miss their predicted places by {misfit_px:.1f} px",
            detection,
            lens,
            f"check the focal length and the pattern{free}.",
        )
    if 2 * int(fit.used.sum()) < len(fit.used):
        return (
            f"only {int(fit.used.sum())} of {len(fit.used)} circles agree on one camera: check "
            "the pattern and the picture."
        )
    return None


def _with_fold(failed: str, detection: Detection, lens: Intrinsics, otherwise: str) -> str:
    """What failed, with the fold of the lens as its cause, or with what else to do.

    A fold in the corners of the image is no cause where no circle lies beyond it.
    """
    fold = describe_fold(lens)
    away_px = np.linalg.norm(detection.centres_px - np.asarray(lens.principal_point_px), axis=1)
    is_beyond = bool((away_px > lens.valid_radius_px).any())
    if fold is None or not (is_beyond or describe_unusable_fold(lens) is not None):
        return f"{failed}: {otherwise}"
    return f"{failed}, as the lens {fold}: {FOLD_REMEDY}"


def is_suspect(tests: Sequence[Alternative], reduced_chi_square: float) -> bool:
    """Whether the images contradict what is held fixed: the residuals exceed their sigmas, or the
    likeliest change would move the camera by more than its own sigmas allow."""
    scatters = reduced_chi_square > TUNING.answer.large_chi_square
    return (scatters and bool(tests) and tests[0].found) or any(test.is_strained for test in tests)


def notes_of_misfit(circles: Adjustment, view: int) -> tuple[str, ...]:
    """Where nothing else is said against a camera: errors many times the noise, which neighbouring
    circles share.

    circles : the adjustment of all cameras by their circles.
    """
    times = float(circles.enlarged[view])
    if times <= TUNING.answer.strain_sigmas:
        return ()
    if autocorrelation_of_circles(circles, view) <= normal_limit(TUNING.answer.chance_of_answers):
        return ()
    off_px = np.sqrt(np.mean(errors_px(circles.problem)[view][circles.used[view]] ** 2))
    return (
        f"neighbouring circles lie aside alike, by {off_px:.2g} px, {times:.0f} times their noise: "
        "the lens is another than was said, the sheet bends otherwise, or something moved while "
        "the picture was read out.",
    )


def lens_strain_sentence(strain: float) -> str:
    """strain : by how many of its sigmas a lens is off that was stated with a covariance."""
    return (
        f"the lens is another than was said, by {strain:.1f} of its sigmas: check focal length, "
        "pixel pitch and focus, that nobody resized or turned the picture, or calibrate its "
        "intrinsics."
    )


def notes_of_aim(adjustment: Adjustment, view: int, known: Knowledge) -> tuple[str, ...]:
    """A note on an aim beside the origin, where it is significant and large enough to matter."""
    if not known.aim_sigma_mm:
        return ()
    step = adjustment.rows(view)
    aim_mm, unit_mm = (
        adjustment.parameters(view)[4:6],
        float(adjustment.problem.parametrization.unit_mm),
    )
    if np.abs(aim_mm).max() < TUNING.answer.least_aim_mm:
        return ()
    covariance = adjustment.covariance[np.ix_(step, step)][4:6, 4:6] * unit_mm**2
    squared = aim_mm @ np.linalg.solve(covariance, aim_mm)
    if not chi_square_tail(squared, len(aim_mm)) < TUNING.answer.chance:
        return ()
    sigma_mm = np.sqrt(np.diag(covariance))
    return (
        f"the optical axis misses the origin of the sheet by ({aim_mm[0]:.2f}, {aim_mm[1]:.2f}) "
        f"+- ({sigma_mm[0]:.1g}, {sigma_mm[1]:.1g}) mm, which the parameters allow for.",
    )


def notes_of_camera(
    choice: CameraChoice,
    pattern: Pattern,
    used: Bool[np.ndarray, "m"],
    tests: Sequence[Alternative],
    reduced_chi_square: float,
    gauge: tuple[str, ...],
) -> tuple[str, ...]:
    """Sentences on what a user of a good fit should know.

    used : circles that took part. tests : of the places that were used. reduced_chi_square : of
        the circles.
    """
    detection, picture = choice.camera.detection, choice.picture
    notes = []
    telling = [test for test in tests[:1] if test.found] or [t for t in tests if t.is_strained]
    notes += [test.sentence for test in telling[:1]]
    if picture is not None and picture.note is not None:
        notes.append(f"{picture.note} Its circles alone were used.")
    elif picture is not None and choice.method == "points" and picture.is_processed:
        notes.append(
            "software has sharpened the picture, and its grey levels disagree with the circles' "
            "centres or among themselves. Its circles alone were used."
        )
    elif picture is not None and choice.method == "points":
        notes.append(
            "the grey levels disagree with the circles' centres more than noise can explain: the "
            "picture is processed, uneven or covered in a way that the model does not know. Its "
            "circles alone were used."
        )
    elif choice.agreement < TUNING.answer.chance_of_answers:
        notes.append(
            "the circles' centres disagree with the grey levels, as shadows, uneven light and blur "
            "make them. The grey levels were used."
        )
    dropped = detection.circle_index[~used]
    if len(dropped):
        notes.append(
            f"{len(dropped)} circle{'s were' if len(dropped) > 1 else ' was'} located wrongly and "
            f"left out: {', '.join(str(k) for k in dropped)}."
        )
    if len(detection) < len(pattern):
        notes.append(f"{len(detection)} of {len(pattern)} circles were found.")
    if gauge:
        notes.append(f"{' and '.join(gauge)} are not determined one by one.")
    quality = picture.quality if picture is not None else None
    if quality is not None and quality.found:
        notes.append(f"the picture shows {', '.join(quality.found)}; this was fitted along.")
    if quality is not None and quality.pixels_cut > TUNING.answer.cut_share * quality.pixels:
        share = quality.pixels_cut / (quality.pixels + quality.pixels_cut)
        notes.append(
            f"{100 * share:.0f} % of the pixels near the sheet's edges show something else and "
            "were left out."
        )
    if quality is not None and quality.reduced_chi_square > TUNING.answer.large_chi_square:
        notes.append(
            f"the picture departs from the model by {quality.noise:.1f} grey levels, where its "
            f"own noise is {quality.noise_floor:.1f}; its sigmas are those of the larger."
        )
    if choice.method == "points" and reduced_chi_square > TUNING.answer.large_chi_square:
        notes.append(
            f"the circles scatter {np.sqrt(reduced_chi_square):.1f} times as much as their "
            "own sigmas say; the parameters' sigmas are enlarged by that factor."
        )
    if choice.scatter > 1.0:
        notes.append(
            f"parts of the sheet disagree {choice.scatter:.1f} times as much as their circles' "
            "sigmas say; the parameters' sigmas are enlarged by that factor."
        )
    return tuple(notes)
