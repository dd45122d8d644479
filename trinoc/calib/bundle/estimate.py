"""One joint estimate: maximum-likelihood cameras and lines for given tracks, with their errors.

The log posterior of cameras and tracks compares one matching with another. A fragment is the part
of a detected segment that a track uses. Two fragments always agree with one line, whatever the
cameras are. Each further fragment is either correct, with the normal density of its squared
distance s, or clutter. The density of clutter is that of a correct fragment at c sigma, where c^2
is the ceiling of the robust loss rho. Relative to the assumption that all n fragments are clutter,
a line has the log likelihood

    1/2 max(0, (n - 2) c^2 - sum over its fragments of rho(s)).

It is 0 in two views, and 0 if a fragment is wrong. Half the squared Mahalanobis distance between
these cameras and the calibrated cameras is subtracted. Terms that are equal for all matchings of
the same segments are omitted. Stated sigmas are used, since they are equal for all compared
matchings.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from trinoc.calib.bundle.camera import CameraState, camera_of_state, camera_state, stack_states
from trinoc.calib.bundle.covariance import (
    determined_part,
    segment_and_errors,
    segment_factor,
    sheet_factor,
)
from trinoc.calib.bundle.factors import PosePrior
from trinoc.calib.bundle.joint_problem import (
    CamerasAndLines,
    FragmentTable,
    JointProblem,
    squared_distances,
    with_lines_of_two_views,
)
from trinoc.calib.bundle.result import RefineResult, RefineStatus
from trinoc.calib.problem.solver import solve
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.errors import InputError
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import LineObservations
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.numerics.buckets import bucket, pad_rows
from trinoc.numerics.precision import ArrayLike, as_numpy
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: sigma, in mm or px, of parameters that the calibration fixed, such as an aim or a lens.
# They stay fixed in cameras that did not move. Segments cannot distinguish it from zero.
FIXED_SIGMA = 1e-3


class FreeParameters(NamedTuple):
    """The parameters that a refinement estimates, and the cameras that keep their prior.

    Attributes
    ----------
    pose_model : estimated parameters of each pose.
    intrinsics : whether focal lengths and principal points are estimated.
    trusted : names of the cameras whose calibrated pose is used as a prior. The others may have
        moved.
    aim_fixed : whether the aims of the trusted cameras are fixed, because the calibration assumed
        them exact.
    lens_fixed : whether lenses without a prior are fixed.
    """

    pose_model: PoseModel
    intrinsics: bool
    trusted: tuple[str, ...]
    aim_fixed: bool = False
    lens_fixed: bool = False

    def fixes_all_aims_of(self, rig: Rig) -> bool:
        """True if the aims of all cameras of a rig are fixed. The result then contains no aims."""
        return self.aim_fixed and set(self.trusted) >= set(rig.names)


def joint_estimate(
    rig: Rig,
    sheet_rig: Rig,
    lines: LineObservations,
    free_parameters: FreeParameters,
    calibrated: CalibrationResult | Rig,
    tuning: CalibTuning,
) -> RefineResult:
    """Estimate cameras and lines together by maximum likelihood, with the calibration as a prior.

    Parameters
    ----------
    rig : initial cameras.
    sheet_rig : calibrated rig; its values and covariance are the prior.
    lines : observations of each line: parts of detected segments. The views are the cameras of
        `rig`, in the same order.
    free_parameters : estimated parameters.
    calibrated : result of the calibration, whose residuals show whether its sigmas are right.
    tuning : constants of the method.
    """
    tracks, lines_mm = _pad_tracks(lines)
    start = CamerasAndLines(_cameras(rig, free_parameters), lines_mm)
    sheet_cameras = _cameras(sheet_rig, free_parameters)
    information = prior_information(sheet_rig, sheet_cameras.names, free_parameters)
    loss = GemanMcClure.from_scale(np.asarray(tuning.bundle.loss_sigmas))
    widenings = np.asarray(tuning.bundle.widenings)
    fit = as_numpy(_fit(start, tracks, sheet_cameras, information, loss, widenings))
    count = len(lines)
    squared = fit.squared[:count]
    determined = determined_part(fit.information, fit.sheet_information)
    trace_sheet = float(np.trace(fit.sheet_information @ determined.covariance))
    factor, inlier = segment_factor(squared, lines.seen, determined.rank - trace_sheet, tuning)
    sheet_chi_square = float(fit.sheet_chi_square)
    sheet_fit_chi_square, sheet_fit_redundancy = _residuals_of_sheet(calibrated)
    redundancy = sheet_fit_redundancy + np.count_nonzero(np.diag(information)) - trace_sheet
    sheet = sheet_factor(sheet_fit_chi_square + sheet_chi_square, redundancy, tuning)

    segment_information = fit.information - fit.sheet_information
    weighted = factor**-2 * segment_information + sheet**-2 * fit.sheet_information
    determined = determined_part(weighted, fit.sheet_information)
    all_names = [f"{camera}.{name}" for camera in rig.names for name in sheet_cameras.names]
    reported = np.flatnonzero(
        [not free_parameters.fixes_all_aims_of(rig) or ".aim_" not in name for name in all_names]
    )
    names = tuple(all_names[i] for i in reported)
    covariance = (fit.by_step @ determined.covariance @ fit.by_step.T)[np.ix_(reported, reported)]
    refined = {
        name: camera_of_state(jax.tree.map(lambda leaf, v=v: leaf[v], fit.cameras), rig[name])
        for v, name in enumerate(rig.names)
    }
    status = RefineStatus.NOT_CONVERGED
    if fit.converged:
        status = RefineStatus.GAUGE_FREE if determined.gauge else RefineStatus.CONVERGED
    probability = log_posterior(squared, lines.seen, sheet_chi_square, loss)
    has_covariance = not determined.gauge and free_parameters.pose_model is not PoseModel.RIGID
    segment_covariance = factor**2 * fit.fragment_covariance_mm2[:count]
    return RefineResult(
        status,
        Rig(refined, parameters=names, covariance=covariance) if has_covariance else Rig(refined),
        names,
        fit.values.reshape(-1)[reported],
        covariance,
        UncertainLines(
            fit.ends_mm[:count], segment_covariance, fit.by_cameras[:count], determined.covariance
        ),
        inlier,
        np.where(lines.seen, np.sqrt(squared), np.nan),
        determined.rank - (len(all_names) - len(reported)),
        determined.gauge,
        factor,
        sheet,
        sheet_chi_square,
        (float(fit.cost), float(fit.first_cost)),
        probability,
        (probability,),
        lines,
    )


def squared_distances_with_rig(
    rig: Rig, lines: LineObservations, free_parameters: FreeParameters
) -> Float[np.ndarray, "t v"]:
    """Squared distance, (t, v), of each fragment from the line triangulated from its track, for
    given cameras.

    The unit is squared sigmas of the fragment. Infinite if a distance cannot be computed.
    """
    distances = _squared_distances_from_segments(
        _cameras(rig, free_parameters), _pad_tracks(lines)[0]
    )
    squared = np.asarray(distances)[: len(lines)]
    return np.where(np.isfinite(squared), squared, np.inf)


def _pad_tracks(lines: LineObservations) -> tuple[FragmentTable, Float[np.ndarray, "t 2 3"]]:
    """Return the fragments and the initial lines (t, 2, 3), mm, of all tracks.

    Tracks that no view observes are appended up to one of a few numbers t, so that compiled
    programs are reused.
    """
    is_observed = lines.seen[:, :, None, None]
    # Unobserved fragments may contain anything: replace them by values with finite derivatives.
    fragments = np.where(is_observed, lines.fragments_px, np.array([[0.0, 0.0], [1.0, 0.0]]))
    covariance = np.where(is_observed, lines.covariance_px2, np.eye(4))
    size, lines_mm = bucket(len(lines), finer_above=4096), np.asarray(lines.lines_mm, float)
    tracks = FragmentTable(
        pad_rows(fragments, size, fragments[0]),
        pad_rows(covariance, size, covariance[0]),
        pad_rows(lines.seen, size),
    )
    return tracks, pad_rows(lines_mm, size, lines_mm[0])


def _cameras(rig: Rig, free_parameters: FreeParameters) -> CameraState:
    cameras = stack_states(
        [
            camera_state(
                camera, free_parameters.pose_model, with_intrinsics=free_parameters.intrinsics
            )
            for camera in rig.cameras
        ]
    )
    if not np.isfinite(np.asarray(cameras.working_distance_mm)).all():
        option_name = free_parameters.pose_model.option_name
        raise InputError(
            f'The rig cannot be refined with the pose model "{option_name}", '
            'because a camera\'s axis does not meet the sheet in front of it: use "rigid".'
        )
    return cameras


def prior_information(
    rig: Rig, parameters: tuple[str, ...], free_parameters: FreeParameters
) -> Float[np.ndarray, "k k"]:
    """Information (inverse covariance), (k, k), of the prior of all refined camera parameters.

    Cameras that may have moved have a prior on the lens only, not on the pose.

    Parameters
    ----------
    rig : calibrated rig with its covariance.
    parameters : names of the refined parameters of each camera.
    free_parameters : cameras that keep their prior, and fixed parameters.
    """
    names = [f"{camera}.{name}" for camera in rig.names for name in parameters]
    information = np.zeros((len(names), len(names)))
    is_lens = np.array([name.rpartition(".")[2] in AFFINE_PARAMETERS for name in names])
    trusted = np.repeat(np.isin(rig.names, free_parameters.trusted), len(parameters)) | is_lens
    stated = np.isin(names, rig.parameters)
    has_prior = np.flatnonzero(trusted & stated)
    if len(has_prior):
        covariance = rig.covariance_of([names[i] for i in has_prior])
        if not np.isfinite(covariance).all():
            raise InputError(
                "The covariance of the rig is not finite: calibrate so that all parameters are "
                "determined, or give the rig without a covariance."
            )
        covariance = covariance + np.diag(FIXED_SIGMA**2 * is_lens[has_prior])
        scale = np.sqrt(np.diag(covariance))
        inverse = np.linalg.inv(covariance / np.outer(scale, scale)) / np.outer(scale, scale)
        information[np.ix_(has_prior, has_prior)] = inverse
    if free_parameters.aim_fixed:
        aims = [i for i, name in enumerate(names) if trusted[i] and ".aim_" in name]
        information[aims, aims] = FIXED_SIGMA**-2
    if free_parameters.lens_fixed:
        fixed = np.flatnonzero(is_lens & ~stated)
        information[fixed, fixed] = FIXED_SIGMA**-2
    return information


class _Fit(NamedTuple):
    """Solution of the minimisation, and quantities computed there.

    k is the number of refined camera parameters.

    Attributes
    ----------
    cameras : refined cameras, stacked.
    converged : whether the minimisation converged.
    cost, first_cost : robust cost, with the final width of the loss, at the end and at the start.
    squared : (t, v) squared distance of each fragment from its line, in sigmas.
    information : (k, k) information of lines and calibration prior about the cameras' local
        coordinates.
    sheet_information : (k, k) part of `information` that comes from the calibration prior.
    sheet_chi_square : squared Mahalanobis distance between refined and calibrated cameras.
    by_step : (k, k) Jacobian of the public parameters with respect to the local coordinates.
    values : (v, p) public parameters of each camera.
    ends_mm : (t, 2, 3) ends of the 3-D segments.
    fragment_covariance_mm2 : (t, 6, 6) covariance of the ends for exact cameras and the stated
        noise.
    by_cameras : (t, 6, k) Jacobian of the ends with respect to the cameras' local coordinates.
    """

    cameras: CameraState
    converged: Bool[ArrayLike, ""]
    cost: Float[ArrayLike, ""]
    first_cost: Float[ArrayLike, ""]
    squared: Float[ArrayLike, "t v"]
    information: Float[ArrayLike, "k k"]
    sheet_information: Float[ArrayLike, "k k"]
    sheet_chi_square: Float[ArrayLike, ""]
    by_step: Float[ArrayLike, "k k"]
    values: Float[ArrayLike, "v p"]
    ends_mm: Float[ArrayLike, "t 2 3"]
    fragment_covariance_mm2: Float[ArrayLike, "t 6 6"]
    by_cameras: Float[ArrayLike, "t 6 k"]


@kept_jit
def _fit(
    start: CamerasAndLines,
    tracks: FragmentTable,
    sheet_cameras: CameraState,
    information: Float[ArrayLike, "k k"],
    loss: GemanMcClure,
    widenings: Float[ArrayLike, "r"],
) -> _Fit:
    """Minimise the cost several times with a robust loss whose width decreases, in one program.

    If the last round does not converge, the result is the initial state.

    Parameters
    ----------
    start : initial cameras and lines.
    tracks : fragments of the lines.
    sheet_cameras : calibrated cameras, the mean of the prior.
    information : (k, k) information of the prior.
    loss : robust loss of the last round.
    widenings : (r,) factor of the loss's width in each round.
    """
    start = jax.tree.map(jnp.asarray, start)
    parameters = jax.vmap(lambda camera, origin: camera.parameters(origin))
    prior = PosePrior(parameters(sheet_cameras, sheet_cameras), information, sheet_cameras)
    problem = JointProblem(tracks.in_three_views(), prior, loss)

    def narrower(state: CamerasAndLines, widening: Array) -> tuple[CamerasAndLines, tuple]:
        wide_problem = JointProblem(problem.tracks, prior, loss.widen(widening))
        solution = solve(wide_problem, state)
        return solution.state, (solution.cost, solution.converged)

    end, (costs, converged) = jax.lax.scan(narrower, start, jnp.asarray(widenings))
    end = with_lines_of_two_views(end, tracks)
    scaled = _restore_scale(start, end)
    without_sheet = ~jnp.any(jnp.asarray(information) != 0)
    converged = converged[-1] & jnp.isfinite(costs[-1])
    end = jax.tree.map(lambda a, b: jnp.where(without_sheet, a, b), scaled, end)
    end = jax.tree.map(lambda a, b: jnp.where(converged, a, b), end, start)
    sheet = prior.normal_equations(end.cameras)
    ends_mm, covariance_mm2, by_cameras = jax.vmap(segment_and_errors, (None, 0, 0, 0))(
        end.cameras, *tracks
    )
    return _Fit(
        end.cameras,
        converged,
        costs[-1],
        JointProblem(tracks, prior, loss).cost(start),
        squared_distances(end, tracks),
        problem.line_information(end) + sheet.information,
        sheet.information,
        prior.cost(end.cameras),
        sheet.by_step,
        parameters(end.cameras, sheet_cameras),
        ends_mm,
        covariance_mm2,
        by_cameras,
    )


def _restore_scale(start: CamerasAndLines, end: CamerasAndLines) -> CamerasAndLines:
    """Scale rig and lines so that the spread of the camera centres is that of the initial rig.

    Without a calibration prior the images do not determine the scale, which must not change.
    Cameras that aim at the origin still aim at the origin.
    """

    def centres_and_spread(cameras: CameraState) -> tuple[Array, Array]:
        centres = jax.vmap(lambda camera: camera.pose.centre_world_mm)(cameras)
        offset = centres - jnp.mean(centres, axis=0)[None, :]
        return centres, jnp.sqrt(jnp.sum(offset * offset))

    centres, spread = centres_and_spread(end.cameras)
    factor = centres_and_spread(start.cameras)[1] / spread
    origin = jnp.mean(centres, axis=0)[None, :]
    if end.cameras.pose_model is PoseModel.AIMED:
        origin = jnp.zeros_like(origin)
    poses = jax.vmap(lambda pose, centre: Pose.from_centre(pose.rotation, centre))(
        end.cameras.pose, origin + factor * (centres - origin)
    )
    cameras = eqx.tree_at(lambda state: state.pose, end.cameras, poses)
    return CamerasAndLines(cameras, origin[None] + factor * (end.anchors_mm - origin[None]))


@kept_jit
def _squared_distances_from_segments(
    cameras: CameraState, tracks: FragmentTable
) -> Float[ArrayLike, "t v"]:
    ends = jax.vmap(segment_and_errors, (None, 0, 0, 0))(cameras, *tracks)[0]
    return squared_distances(CamerasAndLines(cameras, ends), tracks)


def _residuals_of_sheet(calibrated: CalibrationResult | Rig) -> tuple[float, float]:
    """Chi-square of the calibration's fit and its degrees of freedom; (0, 0) if only a rig is
    given.
    """
    if isinstance(calibrated, Rig):
        return 0.0, 0.0
    fits = calibrated.fits.values()
    redundancy = [max(2 * int(fit.used.sum()) - fit.rank, 0) for fit in fits]
    chi_square = sum(r * fit.reduced_chi_square for r, fit in zip(redundancy, fits, strict=True))
    return chi_square, sum(redundancy)


def log_posterior(
    squared: Float[np.ndarray, "t v"],
    is_observed: Bool[np.ndarray, "t v"],
    sheet_chi_square: float,
    loss: GemanMcClure,
) -> float:
    """Log posterior of cameras and tracks, relative to the calibrated cameras without any track.

    squared : (t, v) squared distance of each fragment from its line, in sigmas.
    is_observed : (t, v) whether each track is observed in each view.
    sheet_chi_square : squared Mahalanobis distance between refined and calibrated cameras.
    loss : robust loss, which bounds the cost of a wrong fragment.
    """
    costs = np.where(is_observed, loss.rho(squared), 0.0).sum(axis=1)
    gains = (is_observed.sum(axis=1) - 2) * loss.ceiling - costs
    return 0.5 * (float(np.maximum(gains, 0.0).sum()) - sheet_chi_square)
