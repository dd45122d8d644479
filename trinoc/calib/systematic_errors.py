"""The covariance of a calibration, with systematic errors added afterwards."""

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

# Shared by all cameras: print scale along X and Y, and three ways in which a sheet bends.
_SHEET_TERMS = [
    BentPaper.names.index(name) for name in ("print along X", "print along Y", "XX", "YY", "XY")
]


@in_float64
def with_systematics(result: CalibrationResult, systematics: Systematics) -> CalibrationResult:
    """The same calibration with systematic errors added to its covariance.

    Each error moves the circles' centres, and with them the least-squares solution, linearly:
    the implicit derivative of the fitted pose, -(J^T J)^-1 J^T dr/de, carries its covariance.
    Nothing is fitted anew: `trinoc.calibrate(systematics=)` also asks the pictures about these
    errors. An aim that was held stays exact.

    Raises InputError for a negative sigma, a lens covariance of another shape or not finite,
    or one for a camera that the result does not know.
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
        own = [rows[key] for key in (f"{name}.{p}" for p in PARAMETER_NAMES) if key in rows]
        response = _response(result, name, len(own))
        size = response[:, :1] + response[:, 1:2]
        columns = [response[:, :shared_terms] * sheet_sigma, size * systematics.print_size_sigma]
        if name in factors:
            factor = factors[name]
            by_lens = response[:, shared_terms:][:, : len(factor)] @ factor
            if systematics.lens_is_shared:
                columns.append(by_lens)
            else:
                covariance[np.ix_(own, own)] += by_lens @ by_lens.T
        spread = np.zeros((len(covariance), sum(column.shape[1] for column in columns)))
        spread[own] = np.concatenate(columns, axis=1)
        shared.append(spread)
    stacked = np.sum(shared, axis=0)
    covariance += stacked @ stacked.T
    rig = Rig(dict(result.rig.items()), parameters=result.rig.parameters, covariance=covariance)
    told = [rows[key] for key in result.parameters]
    words = (*result.systematics, *systematics.words)
    return replace(
        result, solution=rig, covariance=covariance[np.ix_(told, told)], systematics=words
    )


def _response(result: CalibrationResult, name: str, count: int) -> Float[np.ndarray, "p e"]:
    """Change of a camera's parameters, in degrees and mm, for a unit of each error: those of the
    sheet, then those of its lens."""
    fit, camera = result.fits[name], result.rig[name]
    seen = SheetCamera(name, fit.detection, camera.intrinsics, None, camera.pose)
    priors = SheetPriors(PoseModel.AIM_FREE, Systematics())
    problem = sheet_problem([seen], result.pattern, priors)
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
