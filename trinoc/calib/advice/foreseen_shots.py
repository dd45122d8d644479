"""Ways to hold the board before a rig that anybody can follow, and what each would tell of lenses
and cameras."""

from itertools import product
from typing import NamedTuple

import cv2
import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import build_detection
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import Problem, cam_from_board, lens_number
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.views import View
from trinoc.calib.starts.camera_start import on_board
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import board_names, first_point_indices, list_boards
from trinoc.calib.targets.checkers import Chessboard
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import unproject_pixels
from trinoc.numerics.buckets import blocks

_TILTED = "tilted by {:.0f} degrees"
# numerical: the side of the board that comes nearer, by a turn about the camera's x and y.
_TURNS = {
    "square to it": (0.0, 0.0),
    f"{_TILTED}, its left side toward the camera": (0.0, -1.0),
    f"{_TILTED}, its right side toward the camera": (0.0, 1.0),
    f"{_TILTED}, its upper side toward the camera": (1.0, 0.0),
    f"{_TILTED}, its lower side toward the camera": (-1.0, 0.0),
}
_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "middle", "right")


class Candidate(NamedTuple):
    """A shot that could be taken: before which camera the board is held and how, in words."""

    camera: int
    words: str
    distance_mm: float
    rig_from_board: Pose


def candidate_shots(problem: Problem) -> list[Candidate]:
    """The board in nine places of every camera's picture, at two distances, tilted or not."""
    rules, members = problem.tuning.advice, list_boards(problem.target)
    names = board_names(problem.target)
    set_from_board = [Pose(each) for each in np.asarray(problem.state.set_from_board)]
    shots = []
    for camera, size_px in problem.image_sizes_px.items():
        lens = lens_number(problem, int(problem.parametrization.lens_of_camera[camera]))
        rig_from_cam = Pose(np.asarray(problem.state.cam_from_rig)[camera]).inverse
        for fill, (number, board) in product(rules.fills, enumerate(members)):
            which = f'"{names[number]}" ' if len(members) > 1 else ""
            distance = _distance_mm(board, lens, fill * min(size_px))
            share = np.array([0.5 * fill + rules.margin, 0.5, 1.0 - 0.5 * fill - rules.margin])
            down, across = (grid.ravel() for grid in np.meshgrid(range(3), range(3)))
            at = np.stack([share[across], share[down]], axis=1) * (np.array(size_px) - 1.0)
            rays, has_ray = unproject_pixels(lens, at), lens.is_valid_pixel(at)
            for row, column, ray, is_imaged in zip(down, across, rays, has_ray, strict=True):
                if not is_imaged:
                    continue
                place = which + _place_words(_ROWS[row], _COLUMNS[column])
                for words, about in _TURNS.items():
                    pose = rig_from_cam @ _hold(board, ray, distance, about, rules.tilt_deg)
                    if len(members) > 1:
                        pose @= set_from_board[number].inverse
                    shots.append(
                        Candidate(
                            camera, f"{place}, {words.format(rules.tilt_deg)}", distance, pose
                        )
                    )
    return shots


def _distance_mm(target: AbstractTarget, lens: AbstractLens, side_px: float) -> float:
    """The distance at which the board's longer side takes so many pixels."""
    extent = np.max(np.ptp(target.centres_mm, axis=0) + 2.0 * np.max(target.radius_mm))
    return float(np.max(lens.focal_length_px) * extent / side_px)


def _hold(
    target: AbstractTarget,
    ray: Float[np.ndarray, "3"],
    distance_mm: float,
    about: tuple[float, float],
    tilt_deg: float,
) -> Pose:
    """The board before a camera, its middle on a ray along which it faces it, and then turned."""
    axis = np.cross([0.0, 0.0, 1.0], ray)
    sine = float(np.linalg.norm(axis))
    aim = cv2.Rodrigues(axis / max(sine, 1e-12) * np.arctan2(sine, ray[2]))[0]
    turn = cv2.Rodrigues(np.radians(tilt_deg) * np.append(about, 0.0))[0]
    rotation = aim @ turn @ np.diag([1.0, -1.0, -1.0])
    middle = np.append(0.5 * (target.centres_mm.min(axis=0) + target.centres_mm.max(axis=0)), 0.0)
    return Pose(np.column_stack([rotation, distance_mm * ray - rotation @ middle]))


def _place_words(row: str, column: str) -> str:
    if row == column:
        return "in the middle of its picture"
    if "middle" in (row, column):
        return f"at the {column if row == 'middle' else row} of its picture"
    return f"in the {row} {column} corner of its picture"


class ForeseenShot(NamedTuple):
    """What a candidate would tell.

    Fields
    ------
    candidate : the shot.
    cameras : which would see the board.
    places : how many places all of them would see.
    sigma_px : of a place, root mean square over these.
    information : (f, f) on the free steps of the head, its board eliminated.
    """

    candidate: Candidate
    cameras: tuple[int, ...]
    places: int
    sigma_px: float
    information: Float[np.ndarray, "f f"]


def foresee_shots(problem: Problem, candidates: list[Candidate]) -> list[ForeseenShot]:
    """What those candidates would tell that the cameras before which they are held see.

    The places are taken to be as accurate as those that were seen. No program compiles anew: the
    candidates go through in portions of as many views and shots as there were.
    """
    sigma_px, shots = place_sigma_px(problem), []
    lenses = [lens_number(problem, int(k)) for k in problem.parametrization.lens_of_camera]
    fold_rad = [lens.fold_angle_rad() for lens in lenses]
    in_each = problem.cameras * len(list_boards(problem.target))
    portion = max(1, min(len(problem.state.rig_from_board), len(problem.table.shot) // in_each))
    for part in blocks(len(candidates), portion):
        own = candidates[part]
        posed = _pose_candidates(problem, own, sigma_px)
        views = [
            _with_visible(posed, view, lenses[view.camera], fold_rad[view.camera], uv_px)
            for view, uv_px in zip(posed.views, errors_px(posed), strict=True)
        ]
        information = compute_information(posed._replace(views=tuple(views)))
        rows = np.ix_(information.free, information.free)
        for shot, candidate in enumerate(own):
            seen = [v for v in views if v.shot == shot and v.used.any()]
            cameras = tuple(dict.fromkeys(v.camera for v in seen))
            if candidate.camera not in cameras:
                continue
            counts = np.array([v.used.sum() for v in seen])
            mean = float(
                np.sqrt(np.average(sigma_px[[v.camera for v in seen]] ** 2, weights=counts))
            )
            telling = information.of_shot[shot][rows]
            shots.append(ForeseenShot(candidate, cameras, int(counts.sum()), mean, telling))
    return shots


def place_sigma_px(problem: Problem) -> Float[np.ndarray, "c"]:
    """Standard deviation per axis of a place that each camera saw, as the fit counts it."""
    precision, count = np.zeros(problem.cameras), np.zeros(problem.cameras)
    for view, whitening in zip(problem.views, np.asarray(problem.table.whitening)):
        precision[view.camera] += np.sum(whitening**2)
        count[view.camera] += 2 * view.used.sum()
    return np.sqrt(count / np.maximum(precision, 1e-300))


def _pose_candidates(
    problem: Problem, candidates: list[Candidate], sigma_px: np.ndarray
) -> Problem:
    """The problem with these candidates for its shots, every place of which is seen at (0, 0)."""
    sizes, boards = problem.image_sizes_px, np.array(problem.state.rig_from_board)
    boards[: len(candidates)] = [each.rig_from_board.cam_from_world for each in candidates]
    state = eqx.tree_at(lambda s: s.rig_from_board, problem.state, boards)
    views = []
    firsts, members = first_point_indices(problem.target), list_boards(problem.target)
    for camera, size_px in sizes.items():
        for number, (first, board) in enumerate(zip(firsts, members, strict=True)):
            index, nowhere = first + np.arange(len(board)), np.zeros((len(board), 2))
            covariance = np.tile(sigma_px[camera] ** 2 * np.eye(2), (len(board), 1, 1))
            everywhere = build_detection(index[None], nowhere, covariance, size_px)
            whole = View(camera, 0, everywhere, np.ones(len(board), dtype=bool), board=number)
            views += [whole._replace(shot=s) for s in range(len(candidates))]
    # As many views as there were, lest the programs compile anew.
    idle = views[0]._replace(shot=len(boards) - 1, used=np.zeros_like(views[0].used))
    views += [idle] * (len(problem.views) - len(views))
    ones = np.ones_like(problem.sigma_factor)
    return problem._replace(
        views=tuple(views), state=state, shots=len(candidates), sigma_factor=ones
    )


def _with_visible(
    problem: Problem, view: View, lens: AbstractLens, fold_rad: float, uv_px: np.ndarray
) -> View:
    """The view with the places (n, 2) that the camera sees, if it would find the board at all."""
    if not view.used.any():
        return view
    board, pose = list_boards(problem.target)[view.board], cam_from_board(problem.state, view)
    places = pose.transform_points(on_board(board.centres_mm))
    away = np.linalg.norm(places, axis=1)
    angle = np.arccos(np.clip(places[:, 2] / away, -1.0, 1.0))
    oblique = np.arccos(np.clip(-(places @ pose.rotation[:, 2]) / away, -1.0, 1.0))
    border = 1.0 + float(np.max(lens.focal_length_px)) * board.radius_mm / away
    inside = np.minimum(uv_px, np.array(view.detection.image_size_px) - 1.0 - uv_px).min(axis=1)
    rules = problem.tuning.advice
    is_shown = oblique < np.radians(rules.most_oblique_deg)
    seen = view.used & (angle < fold_rad) & (inside > border) & is_shown
    least = 1.0 if isinstance(board, Chessboard) else rules.least_seen
    return view._replace(used=seen & (seen.mean() >= least))
