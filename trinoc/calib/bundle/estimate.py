"""One joint estimate: cameras and lines of maximum likelihood for given tracks."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.bundle.gauge import determined_part, with_scale_of
from trinoc.calib.bundle.levenberg_marquardt import JointState, joint_cost, joint_system, minimise
from trinoc.calib.bundle.line_covariance import segment_and_errors
from trinoc.calib.bundle.model_evidence import log_posterior
from trinoc.calib.bundle.pose_prior import PosePrior, d_parameters_d_delta
from trinoc.calib.bundle.problem import FreeParameters, Problem, joint_problem
from trinoc.calib.bundle.result import RefineResult, RefineStatus
from trinoc.calib.bundle.schur import FragmentTable, squared_distances
from trinoc.calib.bundle.variance_components import segment_factor, sheet_factor
from trinoc.calib.model import CameraState, camera_of_state
from trinoc.calib.result import CalibrationResult
from trinoc.geometry import LineObservations, PoseModel, Rig, UncertainLines
from trinoc.numerics import ArrayLike, GemanMcClure, as_numpy, eliminate

# What a fragment can cost, in sigmas squared.
LOSS = GemanMcClure.from_scale(np.asarray(4.0))
# It is first so much wider that everything speaks, then only what fits within a few sigmas.
WIDENINGS = (16.0, 4.0, 1.0)


def joint_estimate(
    rig: Rig,
    sheet_rig: Rig,
    lines: LineObservations,
    choice: FreeParameters,
    calibrated: CalibrationResult | Rig,
) -> RefineResult:
    """The estimate from the cameras of `rig`, what the sheet said being in `sheet_rig`.

    `lines` have the rig's cameras in its order; `calibrated` knows how well the sheet fitted.
    """
    problem = joint_problem(rig, sheet_rig, lines, choice)
    state, first_cost = _annealed(problem)
    cameras, anchors = state.cameras, state.anchors_mm
    has_sheet = bool(np.any(problem.prior.information))
    if not has_sheet:
        cameras, anchors = with_scale_of(cameras, anchors, problem.cameras)
    converged = bool(state.converged) and bool(np.isfinite(state.cost))
    if not converged:
        cameras, anchors = problem.cameras, problem.anchors_mm

    count = len(lines)
    end = as_numpy(_assess(cameras, anchors, problem.tracks, problem.prior))
    squared, sheet_information = end.squared[:count], end.sheet_information
    determined = determined_part(end.information, sheet_information)
    trace_sheet = float(np.trace(sheet_information @ determined.covariance))
    factor, inlier = segment_factor(squared, lines.seen, determined.rank - trace_sheet)
    sheet_chi_square = float(end.sheet_chi_square)
    sheet = _sheet_factor(calibrated, problem.prior, sheet_chi_square, trace_sheet)

    segment_information = end.information - sheet_information
    weighted = factor**-2 * segment_information + sheet**-2 * sheet_information
    determined = determined_part(weighted, sheet_information)
    names = tuple(f"{camera}.{name}" for camera in rig.names for name in cameras.names)
    covariance = end.by_step @ determined.covariance @ end.by_step.T
    claimed = factor**2 * problem.covariance_px2
    ends, own, by_cameras = (
        np.asarray(leaf)[:count] for leaf in _segments_and_errors(cameras, problem.tracks, claimed)
    )
    refined = {
        name: camera_of_state(jax.tree.map(lambda leaf, v=v: leaf[v], cameras), rig[name])
        for v, name in enumerate(rig.names)
    }
    status = RefineStatus.NOT_CONVERGED
    if converged:
        status = RefineStatus.GAUGE_FREE if determined.gauge else RefineStatus.CONVERGED
    probability = log_posterior(squared, lines.seen, sheet_chi_square, LOSS)
    known = not determined.gauge and choice.pose_model is not PoseModel.RIGID
    return RefineResult(
        status,
        Rig(refined, parameters=names, covariance=covariance) if known else Rig(refined),
        names,
        end.values.reshape(-1),
        covariance,
        UncertainLines(ends, own, by_cameras, determined.covariance),
        inlier,
        np.where(lines.seen, np.sqrt(squared), np.nan),
        determined.rank,
        determined.gauge,
        factor,
        sheet,
        sheet_chi_square,
        (float(state.cost), first_cost),
        probability,
        (probability,),
        lines,
    )


def squared_with_rig(
    rig: Rig, lines: LineObservations, choice: FreeParameters
) -> Float[np.ndarray, "t v"]:
    """Squared distances of fragments, in sigmas, from the lines that they give with a rig."""
    problem = joint_problem(rig, rig, lines, choice)
    ends = _segments_and_errors(problem.cameras, problem.tracks, problem.covariance_px2)[0]
    squared = np.asarray(_squared_distances(problem.cameras, ends, problem.tracks))[: len(lines)]
    return np.where(np.isfinite(squared), squared, np.inf)


class _Assessment(NamedTuple):
    """What is read off at the end of a refinement."""

    squared: ArrayLike
    information: ArrayLike
    sheet_information: ArrayLike
    sheet_chi_square: ArrayLike
    by_step: ArrayLike
    values: ArrayLike


@eqx.filter_jit
def _assess(
    cameras: CameraState, anchors_mm: ArrayLike, tracks: FragmentTable, prior: PosePrior
) -> _Assessment:
    undamped = 0.0
    system = joint_system(cameras, anchors_mm, tracks, prior, LOSS, undamped)
    return _Assessment(
        squared_distances(cameras, anchors_mm, tracks),
        eliminate(system.information).reduced,
        prior.normal_equations(cameras)[0],
        prior.cost(cameras),
        d_parameters_d_delta(cameras, prior.start),
        jax.vmap(lambda camera, start: camera.parameters(start))(cameras, prior.start),
    )


def _annealed(problem: Problem) -> tuple[JointState, float]:
    """The minimum under a loss that narrows step by step, and the last loss's first cost."""
    arguments = problem.tracks, problem.prior
    first_cost = _joint_cost(problem.cameras, problem.anchors_mm, *arguments, LOSS)
    first, *further = (LOSS.widened(factor) for factor in WIDENINGS)
    state = minimise(problem.cameras, problem.anchors_mm, *arguments, first)
    for loss in further:
        state = minimise(state.cameras, state.anchors_mm, *arguments, loss)
    return state, float(first_cost)


_joint_cost = eqx.filter_jit(joint_cost)
_squared_distances = eqx.filter_jit(squared_distances)

_segments_and_errors = eqx.filter_jit(
    lambda cameras, tracks, covariance: jax.vmap(segment_and_errors, (None, 0, 0, 0))(
        cameras, tracks.fragments_px, covariance, tracks.seen
    )
)


def _sheet_factor(
    calibrated: CalibrationResult | Rig, prior: PosePrior, chi_square: float, trace: float
) -> float:
    own_chi_square, own_redundancy = 0.0, 0.0
    if isinstance(calibrated, CalibrationResult):
        for fit in calibrated.fits.values():
            redundancy = max(2 * int(fit.used.sum()) - fit.rank, 0)
            own_redundancy += redundancy
            own_chi_square += redundancy * fit.reduced_chi_square
    parameters = np.count_nonzero(np.diag(prior.information))
    return sheet_factor(own_chi_square, own_redundancy, chi_square, parameters - trace)
