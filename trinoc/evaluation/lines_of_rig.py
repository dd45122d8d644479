"""Matched 3-D segments with the errors that all of them share through the cameras.

This file combines the result of matching with the covariance of the calibration; these two rooms do
not import each other.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.bundle.camera import CameraState, camera_state, stack_states
from trinoc.calib.bundle.covariance import segment_and_errors
from trinoc.calib.bundle.factors import d_parameters_d_delta
from trinoc.errors import InputError, list_names
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import LineObservations
from trinoc.geometry.uncertain_lines import UncertainLines
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.buckets import in_blocks
from trinoc.numerics.precision import ArrayLike, as_numpy, in_float64
from trinoc.numerics.programs import kept_jit

# Tracks per call of the kernel, so that one size compiles.
BLOCK = 128
TRACKS, JOINED, CORNERS, WIREFRAME = "tracks", "joined", "corners", "wireframe"


def lines_of_rig(matches: Matches, rig: Rig) -> UncertainLines:
    """Return the 3-D lines of matches with the covariance that comes from the rig's errors.

    Parameters
    ----------
    matches : Matches
        Result of `match_segments`.
    rig : Rig
        Rig that the segments were matched with. It is assumed exact if it has no covariance, or if
        `matches` lack the covariance of their fragments.

    Returns
    -------
    UncertainLines

    Raises
    ------
    InputError
        If the rig lacks a camera of the matches, or its covariance lacks pose parameters.
    """
    missing = [name for name in matches.views if name not in rig.names]
    if missing:
        raise InputError(
            f'The rig has no camera "{missing[0]}"; it has {list_names(rig)}. Give the rig that '
            "these segments were matched with."
        )
    rig = rig.take(matches.views)
    ends, fragment_covariance = np.asarray(matches.lines_mm), np.asarray(matches.covariance_mm2)
    pose_model = _pose_model(rig)
    if pose_model is None or matches.fragments_covariance_px2 is None or len(matches) == 0:
        return independent_lines(ends, fragment_covariance)
    lines, cameras = matches.line_observations(), [rig[name] for name in matches.views]
    open_lens = any(name.rpartition(".")[2] in AFFINE_PARAMETERS for name in rig.parameters)
    states = [camera_state(camera, pose_model, with_intrinsics=open_lens) for camera in cameras]
    fragment_ends, by_steps, parameters_by_step = _fragment_derivatives(lines, states)
    names = [f"{view}.{parameter}" for view in matches.views for parameter in states[0].names]
    by_parameters = _carry_derivative(by_steps, fragment_ends, ends) @ np.linalg.inv(
        parameters_by_step
    )
    # A lens without parameters in the covariance is assumed exact.
    return UncertainLines(ends, fragment_covariance, by_parameters, rig.covariance_of(names))


@in_float64
def with_rig_covariance(matches: Matches, rig: Rig) -> Matches:
    """Return a copy of matches with `rig_covariance_mm2`.

    This is the part of each line's covariance that comes from the errors of the rig.

    Parameters
    ----------
    matches : Matches
        Result of `match_segments`. Its `covariance_mm2`, from errors of the segments, is not
        changed.
    rig : Rig
        Rig that the segments were matched with.

    Returns
    -------
    Matches
        `rig_covariance_mm2` is None if the covariance of the rig is unknown, or lacks the pose of a
        camera.

    Raises
    ------
    InputError
        If the rig lacks a camera of the matches.
    """
    if set(matches.views) <= set(rig.names):
        rig_of_views = rig.take(matches.views)
        if rig_of_views.parameters and _known_pose_model(rig_of_views) is None:
            return replace(matches, rig_covariance_mm2=None)
    lines = lines_of_rig(matches, rig)
    if lines.by_parameters.shape[2] == 0:
        return replace(matches, rig_covariance_mm2=None)
    by = np.asarray(lines.by_parameters)
    covariance = by @ np.asarray(lines.parameter_covariance) @ by.transpose(0, 2, 1)
    return replace(matches, rig_covariance_mm2=(covariance + covariance.transpose(0, 2, 1)) / 2)


def lines_of_form(matches: Matches, rig: Rig, form: str) -> UncertainLines:
    """Return 3-D lines that are derived from tracks, with the covariance from the rig's errors.

    A derived line has the camera errors of its longest track.

    Parameters
    ----------
    matches : Matches
        Result of `match_segments`.
    rig : Rig
        Rig that the segments were matched with.
    form : str
        TRACKS: a line for each track. JOINED: joined collinear lines. CORNERS: joined lines whose
        ends are moved to corners. WIREFRAME: edges of the wire frame.

    Returns
    -------
    UncertainLines

    Raises
    ------
    InputError
        If the matches lack the covariance of their fragments.
    """
    tracks = lines_of_rig(matches, rig)
    if form == TRACKS:
        return tracks
    if form == WIREFRAME:
        from trinoc.match.wire_frame.build import wireframe

        derived_lines = wireframe(matches, rig)
        ends, fragment_covariance = derived_lines.lines_mm, derived_lines.covariance_mm2
    else:
        # Here, as above: every matching imports this file, and puts no tracks together.
        from trinoc.match.line_map.collinear_merge import join_collinear
        from trinoc.match.line_map.corners import snap_corners

        derived_lines = join_collinear(matches, rig)
        ends, fragment_covariance = derived_lines.lines_mm, derived_lines.covariance_mm2
        if form == CORNERS:
            snapped = snap_corners(derived_lines)
            ends, fragment_covariance = snapped.lines_mm, snapped.lines_covariance_mm2
    length = np.linalg.norm(tracks.ends_mm[:, 1] - tracks.ends_mm[:, 0], axis=1)
    longest = np.array(
        [t[length[t].argmax()] for t in map(derived_lines.tracks_of, range(len(derived_lines)))],
        dtype=np.int64,
    )
    by_parameters = _carry_derivative(tracks.by_parameters[longest], tracks.ends_mm[longest], ends)
    return UncertainLines(ends, fragment_covariance, by_parameters, tracks.parameter_covariance)


def independent_lines(
    lines_mm: Float[np.ndarray, "t 2 3"], covariance_mm2: Float[np.ndarray, "t 6 6"]
) -> UncertainLines:
    """Create lines without shared errors, for cameras that are assumed exact."""
    count = len(lines_mm)
    return UncertainLines(lines_mm, covariance_mm2, np.zeros((count, 6, 0)), np.zeros((0, 0)))


def _carry_derivative(
    derivative: Float[np.ndarray, "t 6 k"],
    of_ends_mm: Float[np.ndarray, "t 2 3"],
    to_ends_mm: Float[np.ndarray, "t 2 3"],
) -> Float[np.ndarray, "t 6 k"]:
    """Convert the derivative of two points on each line to that of two other points on it.

    `derivative` is that of the points `of_ends_mm` by k parameters. The result is that of the
    points `to_ends_mm`, which are linear combinations of `of_ends_mm`.
    """
    count = len(of_ends_mm)
    step = of_ends_mm[:, 1] - of_ends_mm[:, 0]
    position = np.einsum("tei,ti->te", to_ends_mm - of_ends_mm[:, :1], step)
    position = position / np.sum(step**2, axis=1)[:, None]
    weight = np.stack([1 - position, position], axis=2)
    end_blocks = derivative.reshape(count, 2, 3, derivative.shape[2])
    return np.einsum("tef,tfik->teik", weight, end_blocks).reshape(derivative.shape)


def _pose_model(rig: Rig) -> PoseModel | None:
    """Pose model of the rig's covariance; None without a covariance.

    Raise `InputError` if the covariance lacks pose parameters of a camera.
    """
    pose_model = _known_pose_model(rig)
    if pose_model is None and rig.parameters:
        raise InputError(
            "The covariance of the rig lacks pan, tilt, swing or distance of a camera. Calibrate "
            "all cameras together, or give the rig without a covariance."
        )
    return pose_model


def _known_pose_model(rig: Rig) -> PoseModel | None:
    """Pose model whose parameters are in the covariance for every camera; None if there is none."""
    for pose_model in (PoseModel.AIM_FREE, PoseModel.AIMED):
        names = itertools.product(rig.names, pose_model.parameter_names)
        if {f"{name}.{parameter}" for name, parameter in names} <= set(rig.parameters):
            return pose_model
    return None


@in_float64
def _fragment_derivatives(
    lines: LineObservations, states: Sequence[CameraState]
) -> tuple[Float[np.ndarray, "t 2 3"], Float[np.ndarray, "t 6 k"], Float[np.ndarray, "k k"]]:
    """Ends of the common parts of the fragments, and derivatives for the errors of the cameras.

    Returns
    -------
    ends_mm : (t, 2, 3)
        Ends of the part of each line that all of its views show.
    by_steps : (t, 6, k)
        Derivative of the ends by the local coordinates of the cameras.
    parameters_by_step : (k, k)
        Derivative of the camera parameters by the local coordinates.
    """
    cameras = stack_states(states)
    columns = (lines.fragments_px, lines.covariance_px2, lines.seen)
    of_tracks = in_blocks(partial(_derivatives, cameras), BLOCK, *columns)
    return as_numpy((*of_tracks, _parameters_by_step(cameras, cameras)))


@kept_jit
def _derivatives(
    cameras: CameraState, fragments_px: ArrayLike, covariance_px2: ArrayLike, visible: ArrayLike
) -> tuple[ArrayLike, ArrayLike]:
    ends, _, by_steps = jax.vmap(segment_and_errors, (None, 0, 0, 0))(
        cameras, fragments_px, covariance_px2, visible
    )
    return ends, by_steps


_parameters_by_step = kept_jit(d_parameters_d_delta)
