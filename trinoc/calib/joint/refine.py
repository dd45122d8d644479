"""Refine a rig jointly against the sheet it was calibrated with and segments matched by it."""

from collections.abc import Callable, Collection
from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from trinoc.calib.joint.camera_state import (
    CameraState,
    Freedom,
    camera_of_state,
    camera_state,
)
from trinoc.calib.joint.fragment_residual import whitening_across
from trinoc.calib.joint.gauge import determined_part, with_scale_of
from trinoc.calib.joint.line_covariance import segment_and_errors
from trinoc.calib.joint.minimise import JointState, joint_cost, joint_system, minimise
from trinoc.calib.joint.reduced_system import Tracks, squared_distances
from trinoc.calib.joint.result import RefineResult, RefineStatus
from trinoc.calib.joint.sheet_prior import SheetPrior, parameters_by_step
from trinoc.calib.joint.variance_components import segment_factor, sheet_factor
from trinoc.calib.result import CalibrationResult
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.arrays import ArrayLike
from trinoc.geometry.line_observations import LineObservations
from trinoc.geometry.precision import as_numpy, in_float64
from trinoc.geometry.rig import Rig
from trinoc.geometry.uncertain_lines import UncertainLines

# The loss first lets everything speak, then fragments within a few sigmas only.
FIRST_SCALE, LAST_SCALE, SCALE_RATIO = 64.0, 4.0, 4.0
MOST_ROUNDS = 8


@runtime_checkable
class Matched(Protocol):
    """Anything that holds tracks of fragments, as the matcher's answer does."""

    def line_observations(self) -> LineObservations:
        """The tracks as observations of lines."""
        ...


@in_float64
def refine(
    calibrated: CalibrationResult | Rig,
    matches: Matched | LineObservations,
    *,
    freedom: Freedom | None = None,
    intrinsics: bool = False,
    moved: Collection[str] = (),
    match_again: Callable[[Rig], Matched | LineObservations] | None = None,
) -> RefineResult:
    """Cameras and 3-D lines of maximum likelihood, given a sheet's calibration and matches.

    `calibrated` is the result of a calibration, or a rig. A rig with a covariance counts as
    the sheet's word; one without leaves position, orientation and scale as they are, and says
    so. `freedom` is what may move in each camera: by default what the covariance names, and
    any rigid motion without one. `intrinsics` frees focal lengths and principal points too.
    `moved` names cameras that were knocked since: what the sheet said of them no longer counts.
    `match_again`, for example `lambda rig: trinoc.match_segments(segments, rig)`, is called
    with each refined rig until the tracks stop changing; a round that lowers the posterior
    (more tracks weigh more, larger distances less) is not accepted.

    Raises InputError where matches and rig do not belong together, CalibrationError where no
    track is left.
    """
    rig = calibrated.rig if isinstance(calibrated, CalibrationResult) else calibrated
    freedom = freedom or _freedom_of(rig)
    unknown = sorted(set(moved) - set(rig.names))
    if unknown:
        raise InputError(
            f"There is no camera {', '.join(unknown)} that could have moved; this rig has "
            f"{', '.join(rig.names)}."
        )
    trusted = tuple(name for name in rig.names if name not in moved)
    choice = _Choice(freedom, intrinsics, trusted)
    best = _refine_once(rig, rig, _observations(matches, rig), choice, calibrated)
    for _ in range(MOST_ROUNDS if match_again is not None else 0):
        if match_again is None or best.status is RefineStatus.NOT_CONVERGED:
            break
        again = _observations(match_again(best.rig), best.rig)
        candidate = _refine_once(best.rig, rig, again, choice, calibrated)
        if candidate.status is RefineStatus.NOT_CONVERGED or not _more_probable(candidate, best):
            break
        best = candidate
    return best


def _freedom_of(rig: Rig) -> Freedom:
    own = {name.rpartition(".")[2] for name in rig.parameters}
    for freedom in (Freedom.SIX, Freedom.FOUR):
        if own >= set(freedom.value):
            return freedom
    return Freedom.POSE


def _observations(matches: Matched | LineObservations, rig: Rig) -> LineObservations:
    lines = matches if isinstance(matches, LineObservations) else matches.line_observations()
    if set(lines.views) != set(rig.names):
        raise InputError(
            f"The matches are of the views {', '.join(lines.views)}, but the rig has the cameras "
            f"{', '.join(rig.names)}: give the rig that these matches were made with."
        )
    if len(lines) == 0:
        raise CalibrationError(
            "There is no track to refine with: match segments of pictures that overlap first."
        )
    order = [lines.views.index(name) for name in rig.names]
    return LineObservations(
        rig.names,
        lines.fragments_px[:, order],
        lines.covariance_px2[:, order],
        lines.seen[:, order],
        lines.lines_mm,
    )


def _more_probable(candidate: RefineResult, best: RefineResult) -> bool:
    """Whether more fragments agree, or as many agree better."""
    gained = int(candidate.inlier.sum()) - int(best.inlier.sum())
    if gained != 0:
        return gained > 0
    return candidate.chi_square[0] < best.chi_square[0] - 1e-3


class _Choice(NamedTuple):
    """What the caller wants refined, and the cameras of which the sheet's word still counts."""

    freedom: Freedom
    intrinsics: bool
    trusted: tuple[str, ...]


class _Problem(NamedTuple):
    """The arrays of one joint problem, tracks padded to a bucket."""

    cameras: CameraState
    anchors_mm: np.ndarray
    tracks: Tracks
    covariance_px2: np.ndarray
    prior: SheetPrior


def _refine_once(
    rig: Rig,
    sheet_rig: Rig,
    lines: LineObservations,
    choice: _Choice,
    calibrated: CalibrationResult | Rig,
) -> RefineResult:
    problem = _problem(rig, sheet_rig, lines, choice)
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
    determined = determined_part(end.information)
    trace_sheet = float(np.trace(sheet_information @ determined.covariance))
    factor, inlier = segment_factor(squared, lines.seen, determined.rank - trace_sheet)
    sheet_chi_square = float(end.sheet_chi_square)
    sheet = _sheet_factor(calibrated, problem.prior, sheet_chi_square, trace_sheet)

    segment_information = end.information - sheet_information
    determined = determined_part(factor**-2 * segment_information + sheet**-2 * sheet_information)
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
    known = not determined.gauge and choice.freedom is not Freedom.POSE
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
    )


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
    cameras: CameraState, anchors_mm: ArrayLike, tracks: Tracks, prior: SheetPrior
) -> _Assessment:
    undamped = 0.0
    return _Assessment(
        squared_distances(cameras, anchors_mm, tracks),
        joint_system(cameras, anchors_mm, tracks, prior, LAST_SCALE, undamped).information,
        prior.normal_equations(cameras)[0],
        prior.cost(cameras),
        parameters_by_step(cameras, prior.start),
        jax.vmap(lambda camera, start: camera.parameters(start))(cameras, prior.start),
    )


def _annealed(problem: _Problem) -> tuple[JointState, float]:
    """The minimum under a loss that narrows step by step, and the last loss's first cost."""
    arguments = problem.tracks, problem.prior
    first_cost = _joint_cost(problem.cameras, problem.anchors_mm, *arguments, LAST_SCALE)
    scale = FIRST_SCALE
    state = minimise(problem.cameras, problem.anchors_mm, *arguments, jnp.asarray(scale))
    while scale > LAST_SCALE:
        scale = max(scale / SCALE_RATIO, LAST_SCALE)
        state = minimise(state.cameras, state.anchors_mm, *arguments, jnp.asarray(scale))
    return state, float(first_cost)


_joint_cost = eqx.filter_jit(joint_cost)

_segments_and_errors = eqx.filter_jit(
    lambda cameras, tracks, covariance: jax.vmap(segment_and_errors, (None, 0, 0, 0))(
        cameras, tracks.fragments_px, covariance, tracks.seen
    )
)


def _problem(rig: Rig, sheet_rig: Rig, lines: LineObservations, choice: _Choice) -> _Problem:
    freedom = choice.freedom
    distorted = any(camera.intrinsics.distortion_model != "none" for camera in rig.cameras)
    cameras, start = (
        _stacked(
            [
                camera_state(
                    camera,
                    freedom,
                    with_intrinsics=choice.intrinsics,
                    with_distortion=distorted,
                )
                for camera in each.cameras
            ]
        )
        for each in (rig, sheet_rig)
    )
    if not np.isfinite(np.asarray(cameras.reach_mm)).all():
        raise InputError(
            f"The rig cannot be refined in {freedom.name.lower()} parameters, because a camera's "
            "axis does not meet the sheet in front of it: use Freedom.POSE."
        )
    seen = lines.seen[:, :, None, None]
    # What is not seen may hold anything: give it numbers that derivatives survive.
    fragments = np.where(seen, lines.fragments_px, np.array([[0.0, 0.0], [1.0, 0.0]]))
    covariance = np.where(seen, lines.covariance_px2, np.eye(4))
    whitening = np.asarray(_whitening(fragments, covariance))
    padding = _bucket(len(lines)) - len(lines)

    def padded(array: np.ndarray) -> np.ndarray:
        return np.concatenate([array, np.repeat(array[:1], padding, axis=0)])

    unseen = np.concatenate([lines.seen, np.zeros((padding, len(rig)), dtype=bool)])
    tracks = Tracks(padded(fragments), padded(whitening), unseen)
    prior = _prior(sheet_rig, start, choice.trusted)
    return _Problem(cameras, padded(lines.lines_mm), tracks, padded(covariance), prior)


_whitening = jax.jit(jax.vmap(jax.vmap(whitening_across)))


def _prior(rig: Rig, start: CameraState, trusted: Collection[str]) -> SheetPrior:
    """The sheet's word on the trusted cameras: the inverse of their part of the covariance."""
    names = [f"{camera}.{name}" for camera in rig.names for name in start.names]
    owner = [camera for camera in rig.names for _ in start.names]
    values = np.asarray(jax.vmap(lambda camera: camera.parameters(camera))(start))
    information = np.zeros((len(names), len(names)))
    known = [i for i, name in enumerate(names) if owner[i] in trusted and name in rig.parameters]
    if known:
        rows = [rig.parameters.index(names[i]) for i in known]
        covariance = np.asarray(rig.covariance)[np.ix_(rows, rows)]
        if not np.isfinite(covariance).all():
            raise InputError(
                "The covariance of the rig is not finite: calibrate so that all parameters are "
                "determined, or give the rig without a covariance."
            )
        information[np.ix_(known, known)] = np.linalg.inv(covariance)
    return SheetPrior(values, information, start)


def _sheet_factor(
    calibrated: CalibrationResult | Rig, prior: SheetPrior, chi_square: float, trace: float
) -> float:
    own_chi_square, own_redundancy = 0.0, 0.0
    if isinstance(calibrated, CalibrationResult):
        for fit in calibrated.fits.values():
            redundancy = max(2 * int(fit.used.sum()) - fit.rank, 0)
            own_redundancy += redundancy
            own_chi_square += redundancy * fit.reduced_chi_square
    parameters = np.count_nonzero(np.diag(prior.information))
    return sheet_factor(own_chi_square, own_redundancy, chi_square, parameters - trace)


def _stacked(states: list[CameraState]) -> CameraState:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)


def _bucket(count: int) -> int:
    """The next size from 64 up, to which tracks are padded: others in its range compile nothing.

    Powers of two; from 4096 up quarters of them, where padding would cost more than compiling.
    """
    power = max(64, 1 << (count - 1).bit_length())
    return power if power <= 4096 else -(-count // (power // 8)) * (power // 8)
