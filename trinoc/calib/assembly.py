"""From adjusted cameras to the result that users see."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from trinoc.calib.adjustment.better_knowledge import advise_better_knowledge, say_what_goes_unseen
from trinoc.calib.adjustment.estimate import Adjustment
from trinoc.calib.adjustment.model_tests import alternatives
from trinoc.calib.messages import (
    is_suspect,
    notes_of_aim,
    notes_of_camera,
    notes_of_misfit,
)
from trinoc.calib.prior_messages import RefutedPriors, notes_of_priors
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.result.calibration import CalibrationResult, CameraFit, Status
from trinoc.calib.result.degrees import largest_sigmas, values_of_parameters
from trinoc.calib.rig_fit import Knowledge, RigFit
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.lenses.registry import simplify_lens
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.numerics.information import Observability, observability_of_root
from trinoc.numerics.precision import in_float64


@in_float64
def result_of_fits(
    fits: Sequence[RigFit],
    known: Knowledge,
    status: Mapping[str, Status],
    failures: dict[str, str],
    others: Mapping[str, CameraFit],
) -> CalibrationResult:
    """The rig, its covariance and what is to be said of each camera.

    fits : of cameras that share nothing. status : of all cameras asked for, in their order.
    others : of cameras that are not in the rig.
    """
    cameras, judged, said = {}, dict(status), dict(others)
    keys, blocks, values, told = [], [], [], []
    reported = known.model.parameter_names
    refutations = [notes_of_priors(fit.adjustment, known) for fit in fits]
    # Cameras that are fitted apart share nothing: the sheet is exact for them.
    of_sheet = tuple(dict.fromkeys(note for one in refutations for note in one.of_sheet))
    for fit, refuted in zip(fits, refutations, strict=True):
        seen = [_observability(fit.adjustment, k) for k in range(len(fit.cameras))]
        own_keys, block = _named_covariance(fit, seen)
        keys += own_keys
        blocks.append(block)
        for k, camera in enumerate(fit.cameras):
            name = camera.camera.name
            cameras[name] = _camera(fit, k)
            said[name], suspect = _camera_fit(fit, k, known, seen[k], refuted)
            if suspect:
                judged[name] = Status.SUSPECT
            values.append(values_of_parameters(fit.adjustment.parameters(k))[: len(reported)])
            told += [f"{name}.{parameter}" for parameter in reported]
    covariance = np.asarray(block_diag(*blocks))
    better = advise_better_knowledge([fit.adjustment for fit in fits], known.systematics)
    unseen = say_what_goes_unseen({name: said[name].alternatives for name in cameras})
    advice = [unseen] if better is None else [better.sentence, unseen]
    rows = [keys.index(key) for key in told]
    return CalibrationResult(
        rig=Rig(cameras, parameters=keys, covariance=covariance),
        status=judged,
        parameters=tuple(told),
        values=np.concatenate(values),
        covariance=covariance[np.ix_(rows, rows)],
        fits=said,
        pattern=known.pattern,
        failures=failures,
        systematics=known.systematics.words,
        notes=of_sheet,
        advice=" ".join(filter(None, advice)),
    )


def _observability(adjustment: Adjustment, view: int) -> Observability:
    """Of one camera's pose, all else being as uncertain as it is."""
    largest = largest_sigmas(adjustment.model, adjustment.distance_mm(view))
    root = adjustment.pose_root(view)
    return observability_of_root(root, adjustment.degrees_by_step(view), largest)


def _named_covariance(
    fit: RigFit, seen: Sequence[Observability]
) -> tuple[list[str], Float[np.ndarray, "k k"]]:
    """Names and covariance of all poses and of the focal lengths and principal points that are
    uncertain; NaN for parameters that are not determined."""
    adjustment = fit.adjustment
    names, blocks, unknown = [], [], []
    for k, choice in enumerate(fit.cameras):
        camera, rows = choice.camera, adjustment.rows(k)
        by_pose = np.zeros((len(rows), len(adjustment.covariance)))
        by_pose[:, rows] = adjustment.degrees_by_step(k)
        unknown += [len(names) + row for row in seen[k].gauge]
        names += [f"{camera.name}.{key}" for key in PARAMETER_NAMES[: len(by_pose)]]
        blocks.append(by_pose)
        if camera.lens_factor is not None:
            by_lens = np.zeros((len(AFFINE_PARAMETERS), len(adjustment.covariance)))
            factor = camera.lens_factor[: len(AFFINE_PARAMETERS)]
            by_lens[: len(factor), adjustment.lens_rows(k)] = factor
            names += [f"{camera.name}.{key}" for key in AFFINE_PARAMETERS]
            blocks.append(by_lens)
    by_unknowns = np.concatenate(blocks)
    covariance = by_unknowns @ adjustment.covariance @ by_unknowns.T
    # Files hold no matrix that rounding made other than symmetric.
    covariance = 0.5 * (covariance + covariance.T)
    covariance[unknown] = np.nan
    covariance[:, unknown] = np.nan
    return names, covariance


def _camera(fit: RigFit, view: int) -> Camera:
    camera, pose = fit.cameras[view].camera, fit.adjustment.pose(view)
    if camera.lens_factor is None:
        return Camera(camera.lens, pose)
    lens, said = simplify_lens(fit.adjustment.lens(view)), camera.lens
    return Camera(Intrinsics.of_lens(lens, said.image_size_px, said.pixel_pitch_mm), pose)


def _camera_fit(
    fit: RigFit, view: int, known: Knowledge, seen: Observability, priors: RefutedPriors
) -> tuple[CameraFit, bool]:
    """What is said of one camera, and whether it is suspect: its residuals are not those of the
    model, or what was said of lens, aim or sheet is refuted."""
    choice, of_circles = fit.cameras[view], fit.of_circles
    used = of_circles.used[view]
    source = fit.adjustment if choice.method == "pixels" else of_circles
    tests = alternatives(
        source,
        view,
        source.freedom[view],
        lens_is_free=choice.camera.lens_factor is not None,
        aim_is_held=known.aim_is_held,
    )
    reduced = float(of_circles.reduced_chi_square[view])
    gauge = tuple(PARAMETER_NAMES[k] for k in seen.gauge)
    refuted = (*priors.of_views[view], *priors.of_sheet)
    suspect = bool(refuted) or is_suspect(tests, float(source.reduced_chi_square[view]))
    if not suspect:
        refuted = notes_of_misfit(of_circles, view)
    notes = notes_of_camera(choice, known.pattern, used, tests, reduced, gauge)
    by_answer = of_circles.problem._replace(state=fit.adjustment.problem.state)
    picture = choice.picture if choice.method == "pixels" else None
    of_aim = () if view in priors.wrong_aims else notes_of_aim(fit.adjustment, view, known)
    result = CameraFit(
        detection=choice.camera.detection,
        residuals_px=errors_px(by_answer)[view],
        rank=seen.rank,
        reduced_chi_square=reduced,
        gauge=gauge,
        notes=(*refuted, *of_aim, *notes),
        used=used,
        image=picture.quality if picture is not None else None,
        alternatives=tuple(tests),
        method=choice.method,
    )
    return result, suspect or bool(refuted)
