"""Board poses that a user can easily reproduce, and the information of each on lenses
and cameras.
"""

from itertools import product
from typing import NamedTuple

import cv2
import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import build_detection
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import Problem, cam_from_board, lens_of_index
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.views import BoardObservation
from trinoc.calib.starts.camera_start import on_board
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import board_names, first_point_indices, list_boards
from trinoc.calib.targets.checkers import Chessboard
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import unproject_pixels
from trinoc.numerics.buckets import blocks

_TILTED = "tilted by {:.0f} degrees"
# numerical: rotations about the camera's x and y, which bring one side of the board nearer.
_TURNS = {
    "square to it": (0.0, 0.0),
    f"{_TILTED}, its left side toward the camera": (0.0, -1.0),
    f"{_TILTED}, its right side toward the camera": (0.0, 1.0),
    f"{_TILTED}, its upper side toward the camera": (1.0, 0.0),
    f"{_TILTED}, its lower side toward the camera": (-1.0, 0.0),
}
_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "middle", "right")


class Candidate(NamedTuple):
    """A possible next shot: a pose of the board in front of one camera.

    Attributes
    ----------
    camera : index of this camera.
    instruction : text that describes how to hold the board.
    distance_mm : distance from the camera to the middle of the board.
    rig_from_board : pose of the board in the frame of the rig.
    """

    camera: int
    instruction: str
    distance_mm: float
    rig_from_board: Pose


def candidate_shots(problem: Problem) -> list[Candidate]:
    """Possible next shots: board poses in front of every camera.

    They are all combinations of nine positions in the image, the distances of `AdviceTuning.fills`,
    and five tilts.
    """
    rules, members = problem.tuning.advice, list_boards(problem.target)
    names = board_names(problem.target)
    set_from_board = [Pose(pose_matrix) for pose_matrix in np.asarray(problem.state.set_from_board)]
    shots = []
    for camera, size_px in problem.image_sizes_px.items():
        lens = lens_of_index(problem, int(problem.parametrization.lens_of_camera[camera]))
        rig_from_cam = Pose(np.asarray(problem.state.cam_from_rig)[camera]).inverse
        for fill, (board_index, board) in product(rules.fills, enumerate(members)):
            board_label = f'"{names[board_index]}" ' if len(members) > 1 else ""
            distance = _distance_mm(board, lens, fill * min(size_px))
            share = np.array([0.5 * fill + rules.margin, 0.5, 1.0 - 0.5 * fill - rules.margin])
            rows, columns = (grid.ravel() for grid in np.meshgrid(range(3), range(3)))
            pixels = np.stack([share[columns], share[rows]], axis=1) * (np.array(size_px) - 1.0)
            rays, has_ray = unproject_pixels(lens, pixels), lens.is_valid_pixel(pixels)
            for row, column, ray, is_imaged in zip(rows, columns, rays, has_ray, strict=True):
                if not is_imaged:
                    continue
                position = board_label + _describe_position(_ROWS[row], _COLUMNS[column])
                for turn, axes in _TURNS.items():
                    pose = rig_from_cam @ _hold(board, ray, distance, axes, rules.tilt_deg)
                    if len(members) > 1:
                        pose @= set_from_board[board_index].inverse
                    shots.append(
                        Candidate(
                            camera, f"{position}, {turn.format(rules.tilt_deg)}", distance, pose
                        )
                    )
    return shots


def _distance_mm(target: AbstractTarget, lens: AbstractLens, side_px: float) -> float:
    """Distance at which the longer side of the board is imaged `side_px` pixels long, mm."""
    extent = np.max(np.ptp(target.centres_mm, axis=0) + 2.0 * np.max(target.radius_mm))
    return float(np.max(lens.focal_length_px) * extent / side_px)


def _hold(
    target: AbstractTarget,
    ray: Float[np.ndarray, "3"],
    distance_mm: float,
    tilt_axes: tuple[float, float],
    tilt_deg: float,
) -> Pose:
    """Pose, cam_from_board, of a tilted board that faces the camera and whose middle lies on a ray.

    ray : unit vector in the frame of the camera.
    distance_mm : distance from the camera to the middle of the board.
    tilt_axes : x and y component of the tilt's rotation axis.
    tilt_deg : angle of the tilt.
    """
    axis = np.cross([0.0, 0.0, 1.0], ray)
    sine = float(np.linalg.norm(axis))
    toward_ray = cv2.Rodrigues(axis / max(sine, 1e-12) * np.arctan2(sine, ray[2]))[0]
    turn = cv2.Rodrigues(np.radians(tilt_deg) * np.append(tilt_axes, 0.0))[0]
    rotation = toward_ray @ turn @ np.diag([1.0, -1.0, -1.0])
    middle = np.append(0.5 * (target.centres_mm.min(axis=0) + target.centres_mm.max(axis=0)), 0.0)
    return Pose(np.column_stack([rotation, distance_mm * ray - rotation @ middle]))


def _describe_position(row: str, column: str) -> str:
    if row == column:
        return "in the middle of its image"
    if "middle" in (row, column):
        return f"at the {column if row == 'middle' else row} of its image"
    return f"in the {row} {column} corner of its image"


class ForeseenShot(NamedTuple):
    """A possible next shot with its predicted information.

    Attributes
    ----------
    candidate : board pose of the shot.
    cameras : indices of the cameras that would detect the board.
    point_count : number of board points detected in all images of the shot.
    sigma_px : root mean square sigma of these points.
    information : (f, f) information about the estimated parameters of lenses, cameras and board,
        with the board pose of the shot eliminated.
    """

    candidate: Candidate
    cameras: tuple[int, ...]
    point_count: int
    sigma_px: float
    information: Float[np.ndarray, "f f"]


def foresee_shots(problem: Problem, candidates: list[Candidate]) -> list[ForeseenShot]:
    """Predict the information of possible next shots, from simulated detections.

    A candidate is omitted if its camera would not detect the board. Board points get the mean
    sigmas of the existing shots. Candidates are processed in groups as large as the present
    problem, so that no program compiles again.
    """
    sigma_px, shots = point_sigma_px(problem), []
    lenses = [lens_of_index(problem, int(k)) for k in problem.parametrization.lens_of_camera]
    fold_rad = [lens.fold_angle_rad() for lens in lenses]
    in_each = problem.cameras * len(list_boards(problem.target))
    portion = max(1, min(len(problem.state.rig_from_board), len(problem.table.shot) // in_each))
    for part in blocks(len(candidates), portion):
        portion_candidates = candidates[part]
        posed = _pose_candidates(problem, portion_candidates, sigma_px)
        views = [
            _with_visible(posed, view, lenses[view.camera], fold_rad[view.camera], uv_px)
            for view, uv_px in zip(posed.views, errors_px(posed), strict=True)
        ]
        information = compute_information(posed._replace(views=tuple(views)))
        rows = np.ix_(information.free, information.free)
        for shot, candidate in enumerate(portion_candidates):
            detected = [v for v in views if v.shot == shot and v.used.any()]
            cameras = tuple(dict.fromkeys(v.camera for v in detected))
            if candidate.camera not in cameras:
                continue
            counts = np.array([v.used.sum() for v in detected])
            mean_sigma_px = float(
                np.sqrt(np.average(sigma_px[[v.camera for v in detected]] ** 2, weights=counts))
            )
            information_of_candidate = information.shot_information[shot][rows]
            shots.append(
                ForeseenShot(
                    candidate, cameras, int(counts.sum()), mean_sigma_px, information_of_candidate
                )
            )
    return shots


def point_sigma_px(problem: Problem) -> Float[np.ndarray, "c"]:
    """Root mean square sigma per axis of a board point in each camera, px, (c,).

    The sigma factors of cameras and images are included.
    """
    precision, count = np.zeros(problem.cameras), np.zeros(problem.cameras)
    for view, whitening in zip(problem.views, np.asarray(problem.table.whitening)):
        precision[view.camera] += np.sum(whitening**2)
        count[view.camera] += 2 * view.used.sum()
    return np.sqrt(count / np.maximum(precision, 1e-300))


def _pose_candidates(
    problem: Problem, candidates: list[Candidate], sigma_px: np.ndarray
) -> Problem:
    """Problem whose shots are the candidates, with (0, 0) as the observed pixel of every board
    point.

    Its residuals are therefore the predicted pixels.
    """
    sizes, boards = problem.image_sizes_px, np.array(problem.state.rig_from_board)
    boards[: len(candidates)] = [
        candidate.rig_from_board.cam_from_world for candidate in candidates
    ]
    state = eqx.tree_at(lambda s: s.rig_from_board, problem.state, boards)
    views = []
    firsts, members = first_point_indices(problem.target), list_boards(problem.target)
    for camera, size_px in sizes.items():
        for board_index, (first, board) in enumerate(zip(firsts, members, strict=True)):
            index, zero_px = first + np.arange(len(board)), np.zeros((len(board), 2))
            covariance = np.tile(sigma_px[camera] ** 2 * np.eye(2), (len(board), 1, 1))
            detection = build_detection(index[None], zero_px, covariance, size_px)
            view = BoardObservation(
                camera, 0, detection, np.ones(len(board), dtype=bool), board=board_index
            )
            views += [view._replace(shot=s) for s in range(len(candidates))]
    # Keep the number of observations, so that no program compiles again.
    unused = views[0]._replace(shot=len(boards) - 1, used=np.zeros_like(views[0].used))
    views += [unused] * (len(problem.views) - len(views))
    ones = np.ones_like(problem.sigma_factor)
    return problem._replace(
        views=tuple(views), state=state, shots=len(candidates), sigma_factor=ones
    )


def _with_visible(
    problem: Problem, view: BoardObservation, lens: AbstractLens, fold_rad: float, uv_px: np.ndarray
) -> BoardObservation:
    """Observation in which only the points inside the image are used.

    No point is used if too few are visible for a detection.

    fold_rad : angle from the optical axis at which the lens folds the image.
    uv_px : (n, 2) predicted pixels.
    """
    if not view.used.any():
        return view
    board, pose = list_boards(problem.target)[view.board], cam_from_board(problem.state, view)
    points = pose.transform_points(on_board(board.centres_mm))
    distance = np.linalg.norm(points, axis=1)
    angle = np.arccos(np.clip(points[:, 2] / distance, -1.0, 1.0))
    oblique = np.arccos(np.clip(-(points @ pose.rotation[:, 2]) / distance, -1.0, 1.0))
    border = 1.0 + float(np.max(lens.focal_length_px)) * board.radius_mm / distance
    inside = np.minimum(uv_px, np.array(view.detection.image_size_px) - 1.0 - uv_px).min(axis=1)
    rules = problem.tuning.advice
    is_shown = oblique < np.radians(rules.most_oblique_deg)
    is_visible = view.used & (angle < fold_rad) & (inside > border) & is_shown
    least_share = 1.0 if isinstance(board, Chessboard) else rules.least_seen
    return view._replace(used=is_visible & (is_visible.mean() >= least_share))
