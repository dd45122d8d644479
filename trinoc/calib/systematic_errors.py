"""Covariance of a calibration with systematic errors added afterwards."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.information import whiten_views
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors, sheet_problem
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.result.degrees import degrees_by_step
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.numerics.precision import in_float64

# Errors that all cameras share: print scale along X and Y, and three bends of the sheet.
_SHEET_TERMS = [
    BentPaper.names.index(name) for name in ("print along X", "print along Y", "XX", "YY", "XY")
]


@in_float64
def with_systematics(result: CalibrationResult, systematics: Systematics) -> CalibrationResult:
    """Add systematic errors of sheet and lens to the covariance of a finished calibration.

    Parameters
    ----------
    result : calibration from one image of the sheet per camera.
    systematics : standard deviations of the errors.

    Returns
    -------
    The same calibration with a larger covariance. A fixed aim remains exact.

    Raises
    ------
    InputError : a sigma is negative, or a lens covariance has a wrong shape, is not finite, or
        belongs to an unknown camera.

    Notes
    -----
    An error e moves the circle centres and, to first order, the least-squares solution. Its
    covariance is propagated by the implicit derivative of the pose, -(J^T J)^-1 J^T dr/de, without
    a new fit. In contrast, `trinoc.calibrate(systematics=)` estimates these errors from the images.
    """
    systematics.check()
    lenses = dict.fromkeys(result.status) | {
        name: camera.intrinsics for name, camera in result.rig.items()
    }
    factors = systematics.lens_factors(lenses)
    sheet_sigma = np.array([*systematics.print_scale_sigma, *np.full(3, systematics.flatness_mm)])
    rows = {name: row for row, name in enumerate(result.rig.parameters)}
    shared_terms = len(_SHEET_TERMS)
    covariance, shared = np.array(result.rig.covariance), []
    for name in result.rig.names:
        camera_rows = [rows[key] for key in (f"{name}.{p}" for p in PARAMETER_NAMES) if key in rows]
        response = _response(result, name, len(camera_rows))
        size = response[:, :1] + response[:, 1:2]
        columns = [response[:, :shared_terms] * sheet_sigma, size * systematics.print_size_sigma]
        if name in factors:
            factor = factors[name]
            by_lens = response[:, shared_terms:][:, : len(factor)] @ factor
            if systematics.lens_is_shared:
                columns.append(by_lens)
            else:
                covariance[np.ix_(camera_rows, camera_rows)] += by_lens @ by_lens.T
        spread = np.zeros((len(covariance), sum(column.shape[1] for column in columns)))
        spread[camera_rows] = np.concatenate(columns, axis=1)
        shared.append(spread)
    stacked = np.sum(shared, axis=0)
    covariance += stacked @ stacked.T
    rig = Rig(dict(result.rig.items()), parameters=result.rig.parameters, covariance=covariance)
    parameter_rows = [rows[key] for key in result.parameters]
    descriptions = (*result.systematics, *systematics.descriptions)
    return replace(
        result,
        solution=rig,
        covariance=covariance[np.ix_(parameter_rows, parameter_rows)],
        systematics=descriptions,
    )


def _response(result: CalibrationResult, name: str, count: int) -> Float[np.ndarray, "p e"]:
    """Derivative of one camera's p pose parameters, in degrees and mm, with respect to e errors,
    (p, e).

    The errors are those of the sheet (`_SHEET_TERMS`), then those of the lens parameters.

    name : name of the camera. count : p.
    """
    fit, camera = result.fits[name], result.rig[name]
    sheet_camera = SheetCamera(name, fit.detection, camera.intrinsics, None, camera.pose)
    priors = SheetPriors(PoseModel.AIM_FREE, Systematics())
    problem = sheet_problem([sheet_camera], result.pattern, priors)
    view = problem.views[0]._replace(used=fit.used)
    problem, slices = problem._replace(views=(view,)), problem.slices
    parametrization, jacobian = problem.parametrization, whiten_views(problem).jacobian[0]
    by_step = jacobian[:, slices.camera(0)][:, :count]
    by_sheet = jacobian[:, slices.sheets][:, _SHEET_TERMS]
    by_lens = jacobian[:, slices.lens(0)] / parametrization.lens_scale[0]
    by_error = np.concatenate([by_sheet, by_lens], axis=1)
    step = -np.linalg.solve(by_step.T @ by_step, by_step.T @ by_error)
    by_pose = degrees_by_step(camera.pose, parametrization.unit_mm, PoseModel.AIM_FREE)
    return by_pose[:count, :count] @ step
