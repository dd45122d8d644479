"""Matched 3-D segments with the errors that the cameras of their rig pass on to all of them.

It stands here because it takes the matcher's answer to the calibration's covariance, and these
two rooms do not know each other.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib import (
    CameraState,
    camera_state,
    d_parameters_d_delta,
    segment_and_errors,
    stacked_states,
)
from trinoc.errors import InputError
from trinoc.geometry import AFFINE_PARAMETERS, LineObservations, PoseModel, Rig, UncertainLines
from trinoc.match import Matches, Wireframe, join_collinear, snap_corners, wireframe
from trinoc.numerics import ArrayLike, as_numpy, in_float64, padded

# Tracks are padded to a multiple of this, so that few sizes compile.
BLOCK = 128


def lines_of_rig(matches: Matches, rig: Rig) -> UncertainLines:
    """The matches' lines, whose own covariance is joined by that of the rig's parameters.

    A rig without a covariance counts as exact; so do matches that do not hold the covariance of
    their fragments. Raises InputError where the rig lacks a camera of the matches.
    """
    missing = [name for name in matches.views if name not in rig.names]
    if missing:
        raise InputError(
            f'The rig has no camera "{missing[0]}", but {", ".join(rig.names)}: give the rig that '
            "these matches were made with."
        )
    ends, own = np.asarray(matches.lines_mm), np.asarray(matches.covariance_mm2)
    pose_model = _pose_model_of(rig)
    if pose_model is None or matches.fragments_covariance_px2 is None or len(matches) == 0:
        return UncertainLines(ends, own, np.zeros((len(ends), 6, 0)), np.zeros((0, 0)))
    lines, cameras = matches.line_observations(), [rig[name] for name in matches.views]
    states = [
        camera_state(each, pose_model, with_intrinsics=_lens_is_open(rig)) for each in cameras
    ]
    common, by_steps, by_step = _of_fragments(lines, states)
    names = [f"{view}.{parameter}" for view in matches.views for parameter in states[0].names]
    by_parameters = _carried(by_steps, common, ends) @ np.linalg.inv(by_step)
    # A lens of which the covariance says nothing is exact.
    return UncertainLines(ends, own, by_parameters, rig.covariance_of(names))


def joined_lines_of_rig(matches: Matches, rig: Rig, *, corners: bool = False) -> UncertainLines:
    """As `lines_of_rig`, of the straight lines that the tracks lie on, and with `corners` of these
    lines carried to the corners where they meet.

    A joined line follows the cameras as the longest of its tracks does. Raises InputError where
    the matches do not hold the covariance of their fragments.
    """
    tracks = lines_of_rig(matches, rig)
    joined = join_collinear(matches, rig)
    ends, own = joined.lines_mm, joined.covariance_mm2
    if corners:
        snapped = snap_corners(joined)
        ends, own = snapped.lines_mm, snapped.lines_covariance_mm2
    length = np.linalg.norm(tracks.ends_mm[:, 1] - tracks.ends_mm[:, 0], axis=1)
    longest = np.array(
        [t[length[t].argmax()] for t in map(joined.tracks_of, range(len(joined)))], dtype=np.int64
    )
    by_parameters = _carried(tracks.by_parameters[longest], tracks.ends_mm[longest], ends)
    return UncertainLines(ends, own, by_parameters, tracks.parameter_covariance)


def wireframe_of_rig(matches: Matches, rig: Rig) -> tuple[Wireframe, UncertainLines]:
    """The wire frame of the tracks, and its edges as `joined_lines_of_rig` gives lines."""
    tracks, frame = lines_of_rig(matches, rig), wireframe(matches, rig)
    length = np.linalg.norm(tracks.ends_mm[:, 1] - tracks.ends_mm[:, 0], axis=1)
    longest = np.array(
        [t[length[t].argmax()] for t in map(frame.tracks_of, range(len(frame)))], dtype=np.int64
    )
    ends = frame.lines_mm
    by_parameters = _carried(tracks.by_parameters[longest], tracks.ends_mm[longest], ends)
    own = frame.covariance_mm2
    return frame, UncertainLines(ends, own, by_parameters, tracks.parameter_covariance)


def _carried(
    derivative: Float[np.ndarray, "t 6 k"],
    of_ends_mm: Float[np.ndarray, "t 2 3"],
    to_ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 6 k"]:
    """The derivative of other ends on the same lines: they are means of those ends."""
    count = len(of_ends_mm)
    step = of_ends_mm[:, 1] - of_ends_mm[:, 0]
    place = np.einsum("tei,ti->te", to_ends_mm - of_ends_mm[:, :1], step)
    place = place / np.sum(step**2, axis=1)[:, None]
    weight = np.stack([1 - place, place], axis=2)
    parts = derivative.reshape(count, 2, 3, derivative.shape[2])
    return np.einsum("tef,tfik->teik", weight, parts).reshape(derivative.shape)


def _pose_model_of(rig: Rig) -> PoseModel | None:
    """What the rig's covariance is of; None where it holds none."""
    for pose_model in (PoseModel.AIM_FREE, PoseModel.AIMED):
        wanted = {
            f"{name}.{parameter}" for name in rig.names for parameter in pose_model.parameter_names
        }
        if wanted <= set(rig.parameters):
            return pose_model
    if rig.parameters:
        raise InputError(
            "The covariance of the rig is not of pan, tilt, swing and distance of every camera: "
            "calibrate all of them together, or give the rig without a covariance."
        )
    return None


def _lens_is_open(rig: Rig) -> bool:
    return any(name.rpartition(".")[2] in AFFINE_PARAMETERS for name in rig.parameters)


@in_float64
def _of_fragments(
    lines: LineObservations, states: Sequence[CameraState]
) -> tuple[Float[np.ndarray, "t 2 3"], Float[np.ndarray, "t 6 k"], Float[np.ndarray, "k k"]]:
    """(ends of the common parts, their Jacobian by the cameras' steps, parameters by steps)."""
    stacked = stacked_states(states)
    count = len(lines)
    size = -(-count // BLOCK) * BLOCK
    columns = (lines.fragments_px, lines.covariance_px2, lines.seen)
    ends, by_steps, by_step = as_numpy(
        _derivatives(stacked, *(padded(column, size, column[:1]) for column in columns))
    )
    return ends[:count], by_steps[:count], by_step


@eqx.filter_jit
def _derivatives(
    cameras: CameraState, fragments_px: ArrayLike, covariance_px2: ArrayLike, seen: ArrayLike
) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
    ends, _, by_steps = jax.vmap(segment_and_errors, (None, 0, 0, 0))(
        cameras, fragments_px, covariance_px2, seen
    )
    return ends, by_steps, d_parameters_d_delta(cameras, cameras)
