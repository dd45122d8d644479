"""Calibration problem of a rig, built from initial lenses, cameras and boards."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.problem import (
    FreeLensParameters,
    Problem,
    basis_of_scales,
    cam_from_board,
    stack_problem_lenses,
    with_lens_free,
)
from trinoc.calib.problem.sheet import WarpedBoard
from trinoc.calib.problem.variables import POSE_SIZE, Parametrization, Priors, RigState
from trinoc.calib.problem.views import BoardObservation, shot_capacity
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import list_boards
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import PoseModel

# numerical: smaller sigmas count as exact.
_SMALLEST_SIGMA = 1e-12


def start_problem(
    views: Sequence[BoardObservation],
    target: AbstractTarget,
    lenses: Sequence[AbstractLens],
    cam_from_rig: Float[np.ndarray, "c 3 4"],
    rig_from_board: Float[np.ndarray, "s 3 4"],
    image_sizes_px: Sequence[tuple[int, int]],
    freedom: FreeLensParameters,
    systematics: Systematics,
    set_from_board: Float[np.ndarray, "b 3 4"] | None = None,
    tuning: CalibTuning = TUNING,
) -> Problem:
    """Build the calibration problem of a rig from initial lenses and poses.

    The frame of the rig is that of the first camera, whose pose is fixed. If several boards are
    fixed to each other (a set), the pose of the first board in the set is fixed, too.

    Parameters
    ----------
    views : observations of the board.
    target : the board, or the set of boards.
    lenses : initial lenses, of one model.
    cam_from_rig : (c, 3, 4) initial pose of each camera.
    rig_from_board : (s, 3, 4) initial pose of the board in each shot.
    image_sizes_px : (width, height) of the images of each lens.
    freedom : lens of each camera, and the estimated lens parameters.
    systematics : standard deviations of the errors of the board.
    set_from_board : (b, 3, 4) initial pose of each board in a set.
    tuning : constants of the method.
    """
    members = list_boards(target)
    in_set = np.zeros((0, 3, 4))
    if len(members) > 1 and set_from_board is not None:
        in_set = np.asarray(set_from_board)
    shots = len(rig_from_board)
    spare_poses = shot_capacity(shots) - shots
    boards = np.concatenate([rig_from_board, np.broadcast_to(np.eye(3, 4), (spare_poses, 3, 4))])
    stacked = stack_problem_lenses(lenses)
    scale = np.stack(
        [lens.parameter_scales(size) for lens, size in zip(lenses, image_sizes_px, strict=True)]
    )
    state = RigState(
        stacked,
        np.asarray(cam_from_rig),
        boards,
        in_set,
        np.zeros(len(WarpedBoard.names) * len(members)),
        np.zeros((0, 3)),
    )
    depths = [np.linalg.norm(cam_from_board(state, view).translation_mm) for view in views]
    information, sheet_free = _sheet_prior(systematics, len(members))
    pose_free, set_free = np.ones((len(cam_from_rig), POSE_SIZE)), np.ones((len(in_set), POSE_SIZE))
    pose_free[0] = 0.0
    set_free[:1] = 0.0
    free = (freedom.free, pose_free, set_free, sheet_free)
    unit_mm = float(np.median(depths))
    parametrization = Parametrization(
        lens_basis=basis_of_scales(scale),
        unit_mm=np.asarray(unit_mm),
        sheet_model=WarpedBoard(
            np.stack([np.abs(board.centres_mm).max(axis=0) for board in members])
        ),
        sheet_scale=np.tile([1.0, 1.0, unit_mm, unit_mm], len(members)),
        lens_of_camera=np.asarray(freedom.lens_of_camera),
        free=np.concatenate([part.astype(float).ravel() for part in free]),
        boards_free=np.ones(()),
        priors=Priors(
            lens_mean=np.zeros_like(scale),
            lens_information=np.zeros((*scale.shape, scale.shape[1])),
            sheet_information=information,
            shape_information=np.zeros((0, 0)),
            aim_information=np.zeros(len(cam_from_rig)),
        ),
        pose_model=PoseModel.RIGID,
        has_circles=bool(np.any(target.radius_mm > 0)),
    )
    factor = np.ones(len(cam_from_rig))
    problem = Problem(tuple(views), target, state, parametrization, shots, factor, tuning=tuning)
    return with_lens_free(problem, freedom.free)


def _sheet_prior(
    systematics: Systematics, boards: int
) -> tuple[Float[np.ndarray, "w w"], Float[np.ndarray, "w"]]:
    """Prior information of the print scales and warps of all boards, and the mask of the uncertain
    ones.

    All boards have one common error of the print size, as from one printer. The errors of the
    scales along X and Y, and the warps, are independent for each board.
    """
    terms = len(WarpedBoard.names)
    size = np.zeros((terms, terms))
    size[:2, :2] = systematics.print_size_sigma**2
    board_covariance = np.diag([*np.square(systematics.print_scale_sigma), 0.0, 0.0])
    board_covariance += np.diag([0.0, 0.0, systematics.flatness_mm**2, systematics.flatness_mm**2])
    covariance = np.kron(np.ones((boards, boards)), size) + np.kron(
        np.eye(boards), board_covariance
    )
    free = (np.diag(covariance) > _SMALLEST_SIGMA**2).astype(float)
    # Fully correlated scales are one unknown: a small independent variance keeps the inverse.
    covariance += np.diag(np.where(free > 0, 1e-6 * np.diag(covariance), 0.0))
    rows = np.flatnonzero(free)
    information = np.zeros_like(covariance)
    information[np.ix_(rows, rows)] = np.linalg.inv(covariance[np.ix_(rows, rows)])
    return information, free
