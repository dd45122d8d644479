"""The rig from the grey levels: what every picture shows near the board's edges, taken together.

At a rig that points have found, each picture is fitted by itself: light, ink, blur and the board's
pose. That leaves, for each circle, piece of a line or corner, where the picture shows it, and the
information on all of them together, light, ink and blur eliminated. The rig is fitted to these as
to points whose errors they share; the lenses it has then are those for the next look at the
pictures.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.photometric.views import refine_views
from trinoc.calib.problem.apparent_shift import apparent_shift
from trinoc.calib.problem.problem import Problem, cam_from_board, lens_number
from trinoc.calib.problem.robust_fit import RobustFit, errors_px, finish_fit, fit_places
from trinoc.calib.problem.views import View
from trinoc.calib.problem.wrong_circles import drop_wrong_circles
from trinoc.calib.starts.camera_start import on_board
from trinoc.calib.starts.pictures import Pictures, deliver, name_pictures
from trinoc.calib.starts.placing import of_one_moment
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

# numerical: what a picture shows is linear in the places' shifts as far as these are small beside
# its blur, so that few rounds change something.
_MOST_ROUNDS = 3
# numerical: pictures that are held in memory at a time.
_PICTURES_AT_ONCE = 32
# numerical: pictures in which it is seen how tags are turned.
_MOST_VIEWS = 5

# The grey levels of what a view has seen.
GreyOfView = Callable[[View], Float[np.ndarray, "h w"]]


class PixelFit(NamedTuple):
    """fit : of the rig to the grey levels. silent : (camera, shot, why) of pictures whose points
    count instead."""

    fit: RobustFit
    silent: list[tuple[int, int, str]]


def expect_method(method: str, target: AbstractTarget, pictures: Mapping[str, Pictures]) -> None:
    """Raises InputError for a method that there is not, or not for these."""
    if method not in ("points", "pixels"):
        raise InputError(f'method is {method!r}, but must be "points" or "pixels".')
    check_kind(target, AbstractTarget, "board", A_BOARD)
    check_kind(pictures, Mapping, "set of pictures", "a dictionary of each camera's shots")
    if method == "pixels" and isinstance(target, BoardSet):
        raise InputError(
            f'"{target.name}" holds several boards, and method "pixels" fits one: give '
            'method="points".'
        )
    for camera, own in name_pictures(pictures).items():
        for shot, given in own.items():
            if method == "pixels" and isinstance(given, Detection):
                raise InputError(_no_picture(camera, shot))


def _no_picture(camera: str, shot: str) -> str:
    return (
        f'{shot} of "{camera}" is a detection, in which no grey levels are left: give the picture, '
        'or method="points".'
    )


def grey_levels(
    pictures: Mapping[str, Pictures], cameras: tuple[str, ...], shots: tuple[str, ...]
) -> GreyOfView:
    """Where the grey levels of a view come from. `shots` : the names of a `PlacedRig`."""
    named = name_pictures(pictures)

    def read_grey(view: View) -> Float[np.ndarray, "h w"]:
        camera = cameras[view.camera]
        shot = of_one_moment(shots[view.shot], camera)
        image = deliver(named[camera][shot])
        if isinstance(image, Detection):
            raise InputError(_no_picture(camera, shot))
        return grey_image(np.asarray(image)).grey

    return read_grey


def fit_pixels(fit: RobustFit, read_grey: GreyOfView) -> PixelFit:
    """Go on from the fit of points, looking at the pictures as often as the lenses change."""
    problem, silent = _with_own_sigmas(fit.problem), []
    board = _find_ink(problem, read_grey)
    for _ in range(_MOST_ROUNDS):
        views, silent = _look(problem, board, read_grey)
        problem = problem._replace(views=views)
        before = errors_px(problem)
        problem, _ = fit_places(drop_wrong_circles(fit_places(problem)[0]))
        moves = [
            np.sqrt(np.mean((after - then) ** 2))
            for after, then, view in zip(errors_px(problem), before, views, strict=True)
            if view.used.any()
        ]
        if max(moves, default=0.0) < problem.tuning.answer.least_shift_px:
            break
    return PixelFit(finish_fit(problem, fit.elsewhere), silent)


def _find_ink(problem: Problem, read_grey: GreyOfView) -> Pattern | SquareSheet:
    board = problem.target
    if isinstance(board, Pattern):
        return board
    if isinstance(board, AprilGrid):
        return square_sheet(board, quarters=quarters_of_tags(problem, board, read_grey))
    return square_sheet(board)


def _with_own_sigmas(problem: Problem) -> Problem:
    """The problem with the factors of its cameras' points in the covariances of these."""
    views = []
    for view in problem.views:
        variance = (problem.sigma_factor[view.camera] * view.sigma_ratio) ** 2
        detection = _scale_detection(view.detection, variance)
        views.append(view._replace(detection=detection, sigma_ratio=1.0))
    ones = np.ones_like(problem.sigma_factor)
    return problem._replace(views=tuple(views), sigma_factor=ones)


def _scale_detection(detection: Detection, variance: float) -> Detection:
    return eqx.tree_at(lambda d: d.covariance_px2, detection, detection.covariance_px2 * variance)


def _look(
    problem: Problem, ink: Pattern | SquareSheet, read_grey: GreyOfView
) -> tuple[tuple[View, ...], list[tuple[int, int, str]]]:
    """The views with what their pictures show, given the rig as it is."""
    used = {str(k): view for k, view in enumerate(problem.views) if view.used.any()}
    poses = {name: cam_from_board(problem.state, view) for name, view in used.items()}
    lenses = {
        name: lens_number(problem, int(problem.parametrization.lens_of_camera[view.camera]))
        for name, view in used.items()
    }
    shifts = {}
    if np.any(problem.state.sheet) or np.any(problem.state.shape):
        shifts = {
            name: apparent_shift(problem, view, poses[name], lenses[name])
            for name, view in used.items()
        }
    fits, names = {}, list(used)
    for part in blocks(len(names), _PICTURES_AT_ONCE):
        pictures = {name: read_grey(used[name]) for name in names[part]}
        own = {name: poses[name] for name in names[part]}
        tuning = problem.tuning.photometric
        fits |= refine_views(pictures, own, ink, lenses, PoseModel.RIGID, shifts, tuning=tuning)
    views, silent = list(problem.views), []
    for name, view in used.items():
        views[int(name)] = view._replace(shown=fits[name].points)
        if fits[name].points is None:
            silent.append((view.camera, view.shot, fits[name].note or ""))
    return tuple(views), silent


def quarters_of_tags(problem: Problem, board: AprilGrid, read_grey: GreyOfView) -> int:
    """By how many quarters of a turn the tags lie elsewhere than `trinoc pattern` draws them.

    Programs that draw AprilGrids differ. It is the turn in which cells of ink are darkest against
    the others, in the first pictures.
    """
    dictionary = opencv_dictionary(board.dictionary)
    cells = np.stack(
        [
            marker_cells(dictionary, number, border=board.border)
            for number in range(board.first, board.first + len(board.tags_mm))
        ]
    )
    middles = (np.arange(cells.shape[1]) + 0.5) / cells.shape[1] - 0.5
    x, y = np.meshgrid(middles, -middles)
    places = board.tags_mm[:, None] + board.tag_mm * np.stack([x, y], axis=-1).reshape(1, -1, 2)
    contrast = np.zeros(4)
    for view in [view for view in problem.views if view.used.any()][:_MOST_VIEWS]:
        lens = lens_number(problem, int(problem.parametrization.lens_of_camera[view.camera]))
        cells_px = project_points(
            cam_from_board(problem.state, view), lens, on_board(places.reshape(-1, 2))
        )
        column, row = np.rint(np.nan_to_num(cells_px, nan=-1.0)).astype(int).T
        grey = read_grey(view)
        seen = (column >= 0) & (row >= 0) & (column < grey.shape[1]) & (row < grey.shape[0])
        levels = grey[row[seen], column[seen]]
        for quarters in range(4):
            ink = np.rot90(cells, quarters, axes=(1, 2)).ravel()[seen]
            if ink.any() and not ink.all():
                contrast[quarters] += levels[~ink].mean() - levels[ink].mean()
    return int(np.argmax(contrast))
