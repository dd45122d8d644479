"""Fit of a rig to the grey levels near the edges of the board.

Each image is first fitted alone, starting from the rig that was fitted to the detected points. The
unknowns are light, ink, blur and the pose of the board. Light, ink and blur are then eliminated.
This gives the position of each circle, piece of a line or corner, and their joint information. The
rig is then fitted to these points with correlated errors. The next round starts from its lenses.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.photometric.views import refine_views
from trinoc.calib.problem.apparent_shift import apparent_shift
from trinoc.calib.problem.problem import Problem, cam_from_board, lens_of_index
from trinoc.calib.problem.robust_fit import RobustFit, errors_px, finish_fit, fit_points
from trinoc.calib.problem.views import BoardObservation
from trinoc.calib.problem.wrong_circles import drop_wrong_circles
from trinoc.calib.starts.camera_start import on_board
from trinoc.calib.starts.pictures import Pictures, deliver, name_pictures
from trinoc.calib.starts.placing import original_shot_name
from trinoc.calib.targets.abstract_target import A_BOARD, AbstractTarget
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.board_set import BoardSet
from trinoc.calib.targets.markers import marker_cells, opencv_dictionary
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet, square_sheet
from trinoc.errors import InputError, check_kind
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.projection import project_points
from trinoc.image.grey import grey_image
from trinoc.numerics.buckets import blocks

# numerical: an image is linear in shifts of the points that are small against its blur, so that
# few rounds suffice.
_MOST_ROUNDS = 3
# numerical: images in memory at a time.
_IMAGES_AT_ONCE = 32
# numerical: images used to find the rotation of the tags.
_MOST_VIEWS = 5

# Grey levels of the image of an observation.
GreyOfView = Callable[[BoardObservation], Float[np.ndarray, "h w"]]


class PixelFit(NamedTuple):
    """Fit of a rig to the grey levels of its images.

    Attributes
    ----------
    fit : the fit.
    images_without_grey_levels : (camera index, shot index, reason) of images whose detected points
        are used instead of grey levels.
    """

    fit: RobustFit
    images_without_grey_levels: list[tuple[int, int, str]]


def expect_method(method: str, target: AbstractTarget, images: Mapping[str, Pictures]) -> None:
    """Raise `InputError` if the method is unknown, or if the board or an image does
    not support it.
    """
    if method not in ("points", "pixels"):
        raise InputError(f'method is {method!r}, but must be "points" or "pixels".')
    check_kind(target, AbstractTarget, "board", A_BOARD)
    check_kind(images, Mapping, "set of images", "a dictionary of each camera's shots")
    if method == "pixels" and isinstance(target, BoardSet):
        raise InputError(
            f'"{target.name}" contains several boards, but method "pixels" supports only one '
            'board: use method="points".'
        )
    for camera, shots in name_pictures(images).items():
        for shot, image in shots.items():
            if method == "pixels" and isinstance(image, Detection):
                raise InputError(_no_picture(camera, shot))


def _no_picture(camera: str, shot: str) -> str:
    return (
        f'{shot} of "{camera}" is a detection without grey levels: give the image, or '
        'method="points".'
    )


def grey_levels(
    images: Mapping[str, Pictures], cameras: tuple[str, ...], shots: tuple[str, ...]
) -> GreyOfView:
    """Return a function that reads the grey levels, (h, w), of the image of an observation.

    images : images of each camera. cameras : names of the cameras.
    shots : names of the shots, as in `InitialRig`.
    """
    images_by_shot = name_pictures(images)

    def read_grey(view: BoardObservation) -> Float[np.ndarray, "h w"]:
        camera = cameras[view.camera]
        shot = original_shot_name(shots[view.shot], camera)
        image = deliver(images_by_shot[camera][shot])
        if isinstance(image, Detection):
            raise InputError(_no_picture(camera, shot))
        return grey_image(np.asarray(image)).grey

    return read_grey


def fit_pixels(fit: RobustFit, read_grey: GreyOfView) -> PixelFit:
    """Fit a rig to the grey levels of its images, starting from its fit to detected points.

    Images and rig are fitted in turn, until the predicted pixels no longer change.

    read_grey : function that returns the grey levels of the image of an observation.
    """
    problem, without_grey_levels = _with_factors_in_covariances(fit.problem), []
    board = _find_ink(problem, read_grey)
    for _ in range(_MOST_ROUNDS):
        views, without_grey_levels = _fit_images(problem, board, read_grey)
        problem = problem._replace(views=views)
        before = errors_px(problem)
        problem, _ = fit_points(drop_wrong_circles(fit_points(problem)[0]))
        moves = [
            np.sqrt(np.mean((after - earlier) ** 2))
            for after, earlier, view in zip(errors_px(problem), before, views, strict=True)
            if view.used.any()
        ]
        if max(moves, default=0.0) < problem.tuning.answer.least_shift_px:
            break
    return PixelFit(finish_fit(problem, fit.rejected_images), without_grey_levels)


def _find_ink(problem: Problem, read_grey: GreyOfView) -> Pattern | SquareSheet:
    board = problem.target
    if isinstance(board, Pattern):
        return board
    if isinstance(board, AprilGrid):
        return square_sheet(board, quarters=quarters_of_tags(problem, board, read_grey))
    return square_sheet(board)


def _with_factors_in_covariances(problem: Problem) -> Problem:
    """Problem in which the covariances of the points contain the factors of their sigmas.

    The factors of cameras and images are then 1.
    """
    views = []
    for view in problem.views:
        variance = (problem.sigma_factor[view.camera] * view.sigma_ratio) ** 2
        detection = _scale_detection(view.detection, variance)
        views.append(view._replace(detection=detection, sigma_ratio=1.0))
    ones = np.ones_like(problem.sigma_factor)
    return problem._replace(views=tuple(views), sigma_factor=ones)


def _scale_detection(detection: Detection, variance: float) -> Detection:
    return eqx.tree_at(lambda d: d.covariance_px2, detection, detection.covariance_px2 * variance)


def _fit_images(
    problem: Problem, ink: Pattern | SquareSheet, read_grey: GreyOfView
) -> tuple[tuple[BoardObservation, ...], list[tuple[int, int, str]]]:
    """Fit the grey levels of each image, with the present rig as initial value.

    Returns the observations with their grey-level points, and (camera index, shot index, reason) of
    the images that could not be fitted.

    ink : the printed shapes of the board.
    """
    used = {str(k): view for k, view in enumerate(problem.views) if view.used.any()}
    poses = {name: cam_from_board(problem.state, view) for name, view in used.items()}
    lenses = {
        name: lens_of_index(problem, int(problem.parametrization.lens_of_camera[view.camera]))
        for name, view in used.items()
    }
    shifts = {}
    if np.any(problem.state.sheet) or np.any(problem.state.shape):
        shifts = {
            name: apparent_shift(problem, view, poses[name], lenses[name])
            for name, view in used.items()
        }
    fits, names = {}, list(used)
    for part in blocks(len(names), _IMAGES_AT_ONCE):
        grey_of_image = {name: read_grey(used[name]) for name in names[part]}
        image_poses = {name: poses[name] for name in names[part]}
        tuning = problem.tuning.photometric
        fits |= refine_views(
            grey_of_image, image_poses, ink, lenses, PoseModel.RIGID, shifts, tuning=tuning
        )
    views, without_grey_levels = list(problem.views), []
    for name, view in used.items():
        views[int(name)] = view._replace(grey_level_points=fits[name].points)
        if fits[name].points is None:
            without_grey_levels.append((view.camera, view.shot, fits[name].note or ""))
    return tuple(views), without_grey_levels


def quarters_of_tags(problem: Problem, board: AprilGrid, read_grey: GreyOfView) -> int:
    """Number of quarter turns by which the printed tags are rotated relative to those that `trinoc
    pattern` draws.

    Programs that draw AprilGrids differ in this. The rotation with the largest contrast between
    paper and ink cells in the first images is returned.

    read_grey : function that returns the grey levels of the image of an observation.
    """
    dictionary = opencv_dictionary(board.dictionary)
    cells = np.stack(
        [
            marker_cells(dictionary, marker_id, border=board.border)
            for marker_id in range(board.first, board.first + len(board.tags_mm))
        ]
    )
    middles = (np.arange(cells.shape[1]) + 0.5) / cells.shape[1] - 0.5
    x, y = np.meshgrid(middles, -middles)
    cells_mm = board.tags_mm[:, None] + board.tag_mm * np.stack([x, y], axis=-1).reshape(1, -1, 2)
    contrast = np.zeros(4)
    for view in [view for view in problem.views if view.used.any()][:_MOST_VIEWS]:
        lens = lens_of_index(problem, int(problem.parametrization.lens_of_camera[view.camera]))
        cells_px = project_points(
            cam_from_board(problem.state, view), lens, on_board(cells_mm.reshape(-1, 2))
        )
        column, row = np.rint(np.nan_to_num(cells_px, nan=-1.0)).astype(int).T
        grey = read_grey(view)
        is_visible = (column >= 0) & (row >= 0) & (column < grey.shape[1]) & (row < grey.shape[0])
        levels = grey[row[is_visible], column[is_visible]]
        for quarters in range(4):
            ink = np.rot90(cells, quarters, axes=(1, 2)).ravel()[is_visible]
            if ink.any() and not ink.all():
                contrast[quarters] += levels[~ink].mean() - levels[ink].mean()
    return int(np.argmax(contrast))
