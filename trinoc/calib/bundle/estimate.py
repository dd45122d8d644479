"""One joint estimate: cameras and lines of maximum likelihood for given tracks, and their errors.

How probable cameras and matches are together, so that one matching can be held against another: of
a line's n fragments any two agree, whatever the cameras: they place the line. Each further one is
either of this line, with the normal density of its squared distance s, or clutter that chance put
there, whose density is that of a right one c sigma off (c^2 is the ceiling of the robust loss rho).
Against the same fragments all being clutter the line gains, in log likelihood,

    1/2 max(0, (n - 2) c^2 - sum over its fragments of rho(s)),

nothing in two views and nothing where a fragment is wrong, and the sheet takes half the squared
distance by which the cameras left its estimate. What is common to all matchings of one set of
segments is left out. Sigmas are those claimed, the same for all that are compared.
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

# numerical: sigma, in mm or px, of what a calibration held in its place, such as an aim or a lens:
# it stays there in the cameras that did not move. No segment can tell it from zero.
HELD_SIGMA = 1e-3


class FreeParameters(NamedTuple):
    """What the caller wants refined, and the cameras for which the prior still holds.

    `aim_held` says that the aims of those stay where they are, the sheet knowing no error of
    them; `lens_held` that lenses of which the prior says nothing stay what they are.
    """

    pose_model: PoseModel
    intrinsics: bool
    trusted: tuple[str, ...]
    aim_held: bool = False
    lens_held: bool = False

    def holds_aims_of(self, rig: Rig) -> bool:
        """Whether no aim of a rig can change, so that the answer need not tell them."""
        return self.aim_held and set(self.trusted) >= set(rig.names)


def joint_estimate(
    rig: Rig,
    sheet_rig: Rig,
    lines: LineObservations,
    choice: FreeParameters,
    calibrated: CalibrationResult | Rig,
    tuning: CalibTuning,
) -> RefineResult:
    """The estimate from the cameras of `rig`, what the sheet said being in `sheet_rig`.

    `lines` have the rig's cameras in its order; `calibrated` knows how well the sheet fitted.
    """
    tracks, lines_mm = _pad_tracks(lines)
    start = CamerasAndLines(_cameras(rig, choice), lines_mm)
    sheet_cameras = _cameras(sheet_rig, choice)
    information = prior_information(sheet_rig, sheet_cameras.names, choice)
    loss = GemanMcClure.from_scale(np.asarray(tuning.bundle.loss_sigmas))
    widenings = np.asarray(tuning.bundle.widenings)
    fit = as_numpy(_fit(start, tracks, sheet_cameras, information, loss, widenings))
    count = len(lines)
    squared = fit.squared[:count]
    determined = determined_part(fit.information, fit.sheet_information)
    trace_sheet = float(np.trace(fit.sheet_information @ determined.covariance))
    factor, inlier = segment_factor(squared, lines.seen, determined.rank - trace_sheet, tuning)
    sheet_chi_square = float(fit.sheet_chi_square)
    own_chi_square, own_redundancy = _residuals_of_sheet(calibrated)
    redundancy = own_redundancy + np.count_nonzero(np.diag(information)) - trace_sheet
    sheet = sheet_factor(own_chi_square + sheet_chi_square, redundancy, tuning)

    segment_information = fit.information - fit.sheet_information
    weighted = factor**-2 * segment_information + sheet**-2 * fit.sheet_information
    determined = determined_part(weighted, fit.sheet_information)
    every = [f"{camera}.{name}" for camera in rig.names for name in sheet_cameras.names]
    kept = np.flatnonzero([not choice.holds_aims_of(rig) or ".aim_" not in name for name in every])
    names = tuple(every[i] for i in kept)
    covariance = (fit.by_step @ determined.covariance @ fit.by_step.T)[np.ix_(kept, kept)]
    refined = {
        name: camera_of_state(jax.tree.map(lambda leaf, v=v: leaf[v], fit.cameras), rig[name])
        for v, name in enumerate(rig.names)
    }
    status = RefineStatus.NOT_CONVERGED
    if fit.converged:
        status = RefineStatus.GAUGE_FREE if determined.gauge else RefineStatus.CONVERGED
    probability = log_posterior(squared, lines.seen, sheet_chi_square, loss)
    known = not determined.gauge and choice.pose_model is not PoseModel.RIGID
    own = factor**2 * fit.fragment_covariance_mm2[:count]
    return RefineResult(
        status,
        Rig(refined, parameters=names, covariance=covariance) if known else Rig(refined),
        names,
        fit.values.reshape(-1)[kept],
        covariance,
        UncertainLines(fit.ends_mm[:count], own, fit.by_cameras[:count], determined.covariance),
        inlier,
        np.where(lines.seen, np.sqrt(squared), np.nan),
        determined.rank - (len(every) - len(kept)),
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
    rig: Rig, lines: LineObservations, choice: FreeParameters
) -> Float[np.ndarray, "t v"]:
    """Squared distances of fragments, in sigmas, from the lines that they give with a rig."""
    found = _squared_distances_from_segments(_cameras(rig, choice), _pad_tracks(lines)[0])
    squared = np.asarray(found)[: len(lines)]
    return np.where(np.isfinite(squared), squared, np.inf)


def _pad_tracks(lines: LineObservations) -> tuple[FragmentTable, Float[np.ndarray, "t 2 3"]]:
    """Fragments and lines, in a number of tracks for which a program is kept."""
    seen = lines.seen[:, :, None, None]
    # What is not seen may hold anything: give it numbers that derivatives survive.
    fragments = np.where(seen, lines.fragments_px, np.array([[0.0, 0.0], [1.0, 0.0]]))
    covariance = np.where(seen, lines.covariance_px2, np.eye(4))
    size, lines_mm = bucket(len(lines), finer_above=4096), np.asarray(lines.lines_mm, float)
    tracks = FragmentTable(
        pad_rows(fragments, size, fragments[0]),
        pad_rows(covariance, size, covariance[0]),
        pad_rows(lines.seen, size),
    )
    return tracks, pad_rows(lines_mm, size, lines_mm[0])


def _cameras(rig: Rig, choice: FreeParameters) -> CameraState:
    cameras = stack_states(
        [
            camera_state(camera, choice.pose_model, with_intrinsics=choice.intrinsics)
            for camera in rig.cameras
        ]
    )
    if not np.isfinite(np.asarray(cameras.reach_mm)).all():
        raise InputError(
            f'The rig cannot be refined with the pose model "{choice.pose_model.option_name}", '
            'because a camera\'s axis does not meet the sheet in front of it: use "rigid".'
        )
    return cameras


def prior_information(
    rig: Rig, parameters: tuple[str, ...], choice: FreeParameters
) -> Float[np.ndarray, "k k"]:
    """The prior's information on the trusted cameras and all lenses: their covariance, inverted.

    `parameters` are those of each camera. A camera that was knocked keeps its lens.
    """
    names = [f"{camera}.{name}" for camera in rig.names for name in parameters]
    information = np.zeros((len(names), len(names)))
    of_lens = np.array([name.rpartition(".")[2] in AFFINE_PARAMETERS for name in names])
    trusted = np.repeat(np.isin(rig.names, choice.trusted), len(parameters)) | of_lens
    stated = np.isin(names, rig.parameters)
    known = np.flatnonzero(trusted & stated)
    if len(known):
        covariance = rig.covariance_of([names[i] for i in known])
        if not np.isfinite(covariance).all():
            raise InputError(
                "The covariance of the rig is not finite: calibrate so that all parameters are "
                "determined, or give the rig without a covariance."
            )
        covariance = covariance + np.diag(HELD_SIGMA**2 * of_lens[known])
        scale = np.sqrt(np.diag(covariance))
        inverse = np.linalg.inv(covariance / np.outer(scale, scale)) / np.outer(scale, scale)
        information[np.ix_(known, known)] = inverse
    if choice.aim_held:
        aims = [i for i, name in enumerate(names) if trusted[i] and ".aim_" in name]
        information[aims, aims] = HELD_SIGMA**-2
    if choice.lens_held:
        held = np.flatnonzero(of_lens & ~stated)
        information[held, held] = HELD_SIGMA**-2
    return information


class _Fit(NamedTuple):
    """Where the minimisation ended, and what is read off there.

    Fields
    ------
    cost, first_cost : by the loss at its last width, at the end and at the start.
    squared : of every fragment's distance, in sigmas.
    information : (k, k) on the cameras' steps, which `sheet_information` is a part of.
    by_step, values : of the public parameters.
    fragment_covariance_mm2, by_cameras : of the segments' ends, by the noise as it was claimed.
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
    """The minimum under a loss that narrows step by step, in one program.

    The loss is `widenings` times as wide from round to round; costs are those of `loss` itself.
    Where it does not converge, everything is that of the start.
    """
    start = jax.tree.map(jnp.asarray, start)
    parameters = jax.vmap(lambda camera, origin: camera.parameters(origin))
    prior = PosePrior(parameters(sheet_cameras, sheet_cameras), information, sheet_cameras)
    problem = JointProblem(tracks.in_three_views(), prior, loss)

    def narrower(state: CamerasAndLines, widening: Array) -> tuple[CamerasAndLines, tuple]:
        wide = JointProblem(problem.tracks, prior, loss.widen(widening))
        solution = solve(wide, state)
        return solution.state, (solution.cost, solution.converged)

    end, (costs, converged) = jax.lax.scan(narrower, start, jnp.asarray(widenings))
    end = with_lines_of_two_views(end, tracks)
    scaled = _restore_scale(start, end)
    without_sheet = ~jnp.any(jnp.asarray(information) != 0)
    converged = converged[-1] & jnp.isfinite(costs[-1])
    end = jax.tree.map(lambda a, b: jnp.where(without_sheet, a, b), scaled, end)
    end = jax.tree.map(lambda a, b: jnp.where(converged, a, b), end, start)
    of_sheet = prior.normal_equations(end.cameras)
    ends_mm, own, by_cameras = jax.vmap(segment_and_errors, (None, 0, 0, 0))(end.cameras, *tracks)
    return _Fit(
        end.cameras,
        converged,
        costs[-1],
        JointProblem(tracks, prior, loss).cost(start),
        squared_distances(end, tracks),
        problem.line_information(end) + of_sheet.information,
        of_sheet.information,
        prior.cost(end.cameras),
        of_sheet.by_step,
        parameters(end.cameras, sheet_cameras),
        ends_mm,
        own,
        by_cameras,
    )


def _restore_scale(start: CamerasAndLines, end: CamerasAndLines) -> CamerasAndLines:
    """Rig and lines scaled so that the centres spread as they did at the start.

    Without a sheet nothing measures the scale: it stays as it was, exactly. Cameras that aim
    at the origin still do so.
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
    """(chi-square, redundancy) of the calibration's own fits; nothing where they are not known."""
    if isinstance(calibrated, Rig):
        return 0.0, 0.0
    fits = calibrated.fits.values()
    redundancy = [max(2 * int(fit.used.sum()) - fit.rank, 0) for fit in fits]
    chi_square = sum(r * fit.reduced_chi_square for r, fit in zip(redundancy, fits, strict=True))
    return chi_square, sum(redundancy)


def log_posterior(
    squared: Float[np.ndarray, "t v"],
    seen: Bool[np.ndarray, "t v"],
    sheet_chi_square: float,
    loss: GemanMcClure,
) -> float:
    """Log posterior of cameras and tracks against cameras at the sheet's estimate and no track.

    `squared` are the fragments' squared distances from their lines in sigmas, which `loss` bounds.
    """
    costs = np.where(seen, loss.rho(squared), 0.0).sum(axis=1)
    gains = (seen.sum(axis=1) - 2) * loss.ceiling - costs
    return 0.5 * (float(np.maximum(gains, 0.0).sum()) - sheet_chi_square)
