"""The arrays of one joint problem: cameras, padded tracks, and what the sheet said."""

from typing import NamedTuple

import jax
import numpy as np

from trinoc.calib.bundle.line_residual import whitening_across
from trinoc.calib.bundle.pose_prior import PosePrior
from trinoc.calib.bundle.schur import FragmentTable
from trinoc.calib.model import CameraState, camera_state, stacked_states
from trinoc.errors import InputError
from trinoc.geometry import AFFINE_PARAMETERS, LineObservations, PoseModel, Rig

# What a calibration held in its place, such as the aim of a camera of four parameters, stays
# there in the cameras that did not move: to a micrometre, which no segment can tell from zero.
HELD_SIGMA_MM = 1e-3
# The same of a lens, and the least that errors which several cameras share differ by.
HELD_SIGMA_PX = 1e-3


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


class Problem(NamedTuple):
    """The arrays of one joint problem, tracks padded to a bucket."""

    cameras: CameraState
    anchors_mm: np.ndarray
    tracks: FragmentTable
    covariance_px2: np.ndarray
    prior: PosePrior


def joint_problem(
    rig: Rig, sheet_rig: Rig, lines: LineObservations, choice: FreeParameters
) -> Problem:
    """The problem from the cameras of `rig`, the sheet having placed those of `sheet_rig`."""
    cameras, start = (
        stacked_states(
            [
                camera_state(camera, choice.pose_model, with_intrinsics=choice.intrinsics)
                for camera in each.cameras
            ]
        )
        for each in (rig, sheet_rig)
    )
    if not np.isfinite(np.asarray(cameras.reach_mm)).all():
        raise InputError(
            f'The rig cannot be refined with the pose model "{choice.pose_model.word}", because a '
            'camera\'s axis does not meet the sheet in front of it: use "rigid".'
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
    tracks = FragmentTable(padded(fragments), padded(whitening), unseen)
    prior = _prior(sheet_rig, start, choice)
    return Problem(cameras, padded(lines.lines_mm), tracks, padded(covariance), prior)


_parameters = jax.jit(jax.vmap(lambda camera: camera.parameters(camera)))
_whitening = jax.jit(jax.vmap(jax.vmap(whitening_across)))


def _prior(rig: Rig, start: CameraState, choice: FreeParameters) -> PosePrior:
    """The prior's information on the trusted cameras and all lenses: their covariance, inverted.

    A camera that was knocked keeps its lens.
    """
    names = [f"{camera}.{name}" for camera in rig.names for name in start.names]
    owner = [camera for camera in rig.names for _ in start.names]
    values = np.asarray(_parameters(start))
    information = np.zeros((len(names), len(names)))
    of_lens = np.array([name.rpartition(".")[2] in AFFINE_PARAMETERS for name in names])
    trusted = [owner[i] in choice.trusted or of_lens[i] for i in range(len(names))]
    known = [i for i, name in enumerate(names) if trusted[i] and name in rig.parameters]
    if known:
        rows = [rig.parameters.index(names[i]) for i in known]
        covariance = np.asarray(rig.covariance)[np.ix_(rows, rows)]
        if not np.isfinite(covariance).all():
            raise InputError(
                "The covariance of the rig is not finite: calibrate so that all parameters are "
                "determined, or give the rig without a covariance."
            )
        covariance = covariance + np.diag(HELD_SIGMA_PX**2 * of_lens[known])
        scale = np.sqrt(np.diag(covariance))
        inverse = np.linalg.inv(covariance / np.outer(scale, scale)) / np.outer(scale, scale)
        information[np.ix_(known, known)] = inverse
    if choice.aim_held:
        aims = [i for i, name in enumerate(names) if trusted[i] and ".aim_" in name]
        information[aims, aims] = HELD_SIGMA_MM**-2
    if choice.lens_held:
        said = np.isin(names, rig.parameters)
        held = np.flatnonzero(of_lens & ~said)
        information[held, held] = HELD_SIGMA_PX**-2
    return PosePrior(values, information, start)


def _bucket(count: int) -> int:
    """The next size from 64 up, to which tracks are padded: others in its range compile nothing.

    Powers of two; from 4096 up quarters of them, where padding would cost more than compiling.
    """
    power = max(64, 1 << (count - 1).bit_length())
    return power if power <= 4096 else -(-count // (power // 8)) * (power // 8)
