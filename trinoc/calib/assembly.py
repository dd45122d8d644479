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
    failed_fits: Mapping[str, CameraFit],
) -> CalibrationResult:
    """The rig, its covariance and what is to be said of each camera.

    fits : of cameras that share nothing. status : of all cameras asked for, in their order.
    failed_fits : of cameras that are not in the rig.
    """
    cameras: dict[str, Camera] = {}
    status_of_camera, camera_fits = dict(status), dict(failed_fits)
    covariance_names: list[str] = []
    covariance_blocks: list[np.ndarray] = []
    parameters: list[str] = []
    values: list[np.ndarray] = []
    pose_parameters = known.model.parameter_names
    refutations = [notes_of_priors(fit.adjustment, known) for fit in fits]
    # Cameras that are fitted apart share nothing: the sheet is exact for them.
    notes_of_sheet = tuple(dict.fromkeys(note for one in refutations for note in one.of_sheet))
    for fit, refuted in zip(fits, refutations, strict=True):
        observabilities = [_observability(fit.adjustment, k) for k in range(len(fit.cameras))]
        names, block = _named_covariance(fit, observabilities)
        covariance_names += names
        covariance_blocks.append(block)
        for k, choice in enumerate(fit.cameras):
            name = choice.camera.name
            cameras[name] = _camera(fit, k)
            camera_fits[name], suspect = _camera_fit(fit, k, known, observabilities[k], refuted)
            if suspect:
                status_of_camera[name] = Status.SUSPECT
            of_pose = values_of_parameters(fit.adjustment.parameters(k))
            values.append(of_pose[: len(pose_parameters)])
            parameters += [f"{name}.{parameter}" for parameter in pose_parameters]
    covariance = np.asarray(block_diag(*covariance_blocks))
    better = advise_better_knowledge([fit.adjustment for fit in fits], known.systematics)
    unseen = say_what_goes_unseen({name: camera_fits[name].alternatives for name in cameras})
    advice = [unseen] if better is None else [better.sentence, unseen]
    rows = [covariance_names.index(parameter) for parameter in parameters]
    return CalibrationResult(
        solution=Rig(cameras, parameters=covariance_names, covariance=covariance),
        status=status_of_camera,
        parameters=tuple(parameters),
        values=np.concatenate(values),
        covariance=covariance[np.ix_(rows, rows)],
        fits=camera_fits,
        target=known.pattern,
        failures=failures,
        systematics=known.systematics.words,
        notes=notes_of_sheet,
        advice=" ".join(filter(None, advice)),
    )


def _observability(adjustment: Adjustment, view: int) -> Observability:
    """Of one camera's pose, all else being as uncertain as it is."""
    largest = largest_sigmas(adjustment.model, adjustment.distance_mm(view))
    root = adjustment.pose_root(view)
    return observability_of_root(root, adjustment.degrees_by_step(view), largest)


def _named_covariance(
    fit: RigFit, observabilities: Sequence[Observability]
) -> tuple[list[str], Float[np.ndarray, "k k"]]:
    """Names and covariance of all poses and of the focal lengths and principal points that are
    uncertain; NaN for parameters that are not determined."""
    adjustment = fit.adjustment
    names: list[str] = []
    jacobians: list[np.ndarray] = []
    undetermined: list[int] = []
    for k, choice in enumerate(fit.cameras):
        camera, steps = choice.camera, adjustment.rows(k)
        of_pose = np.zeros((len(steps), len(adjustment.covariance)))
        of_pose[:, steps] = adjustment.degrees_by_step(k)
        undetermined += [len(names) + row for row in observabilities[k].gauge]
        names += [f"{camera.name}.{key}" for key in PARAMETER_NAMES[: len(of_pose)]]
        jacobians.append(of_pose)
        if camera.lens_factor is not None:
            of_lens = np.zeros((len(AFFINE_PARAMETERS), len(adjustment.covariance)))
            factor = camera.lens_factor[: len(AFFINE_PARAMETERS)]
            of_lens[: len(factor), adjustment.lens_rows(k)] = factor
            names += [f"{camera.name}.{key}" for key in AFFINE_PARAMETERS]
            jacobians.append(of_lens)
    jacobian = np.concatenate(jacobians)
    covariance = jacobian @ adjustment.covariance @ jacobian.T
    # Files hold no matrix that rounding made other than symmetric.
    covariance = 0.5 * (covariance + covariance.T)
    covariance[undetermined] = np.nan
    covariance[:, undetermined] = np.nan
    return names, covariance


def _camera(fit: RigFit, view: int) -> Camera:
    stated, pose = fit.cameras[view].camera, fit.adjustment.pose(view)
    if stated.lens_factor is None:
        return Camera(stated.lens, pose)
    lens = simplify_lens(fit.adjustment.lens(view))
    return Camera(
        Intrinsics.of_lens(lens, stated.lens.image_size_px, stated.lens.pixel_pitch_mm), pose
    )


def _camera_fit(
    fit: RigFit,
    view: int,
    known: Knowledge,
    observability: Observability,
    refuted_priors: RefutedPriors,
) -> tuple[CameraFit, bool]:
    """The fit of one camera, and whether it is suspect: its residuals are not those of the model,
    or what was stated of lens, aim or sheet is refuted."""
    choice, of_circles = fit.cameras[view], fit.of_circles
    used = of_circles.used[view]
    by_pixels = choice.method == "pixels"
    source = fit.adjustment if by_pixels else of_circles
    tests = alternatives(
        source,
        view,
        source.freedom[view],
        lens_is_free=choice.camera.lens_factor is not None,
        aim_is_held=known.aim_is_held,
    )
    reduced = float(of_circles.reduced_chi_square[view])
    gauge = tuple(PARAMETER_NAMES[k] for k in observability.gauge)
    refutations = (*refuted_priors.of_views[view], *refuted_priors.of_sheet)
    suspect = bool(refutations) or is_suspect(tests, float(source.reduced_chi_square[view]))
    if not suspect:
        refutations = notes_of_misfit(of_circles, view)
    of_camera = notes_of_camera(choice, known.pattern, used, tests, reduced, gauge)
    of_aim = ()
    if view not in refuted_priors.wrong_aims:
        of_aim = notes_of_aim(fit.adjustment, view, known)
    at_answer = of_circles.problem._replace(state=fit.adjustment.problem.state)
    camera_fit = CameraFit(
        detections=(choice.camera.detection,),
        residuals_px=errors_px(at_answer)[view],
        rank=observability.rank,
        reduced_chi_square=reduced,
        gauge=gauge,
        notes=(*refutations, *of_aim, *of_camera),
        used=used,
        image=choice.picture.quality if by_pixels and choice.picture is not None else None,
        alternatives=tuple(tests),
        method=choice.method,
    )
    return camera_fit, suspect or bool(refutations)
