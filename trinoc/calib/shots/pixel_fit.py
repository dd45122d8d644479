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

from trinoc.calib.detection import Detection
from trinoc.calib.photometric import refine_views
from trinoc.calib.problem.motions import chained
from trinoc.calib.problem.problem import Problem, lens_number
from trinoc.calib.problem.robust_fit import RobustFit, errors_px, fitted, judged_fit
from trinoc.calib.problem.views import View
from trinoc.calib.problem.wrong_circles import without_wrong_circles
from trinoc.calib.shots.place_shifts import shift_of_places
from trinoc.calib.shots.placing import of_one_moment
from trinoc.calib.shots.printed_tags import quarters_of_tags
from trinoc.calib.shots.sightings_of_shots import Pictures, delivered, named_pictures
from trinoc.calib.targets import (
    AbstractTarget,
    AprilGrid,
    BoardSet,
    Pattern,
    SquareSheet,
    square_sheet,
)
from trinoc.errors import InputError
from trinoc.geometry import Pose, PoseModel
from trinoc.image import grey_image
from trinoc.numerics import blocks

_MOST_ROUNDS = 3
# Another look at the pictures changes nothing once the rig moves places by no more than this: what
# a picture shows is linear in the places' shifts as far as these are small beside its blur.
_STILL_PX = 0.02
# Pictures that are held in memory at a time.
_PICTURES_AT_ONCE = 32

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
    if method == "pixels" and isinstance(target, BoardSet):
        raise InputError(
            f'"{target.name}" holds several boards, and method "pixels" fits one: give '
            'method="points".'
        )
    for camera, own in named_pictures(pictures).items():
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
    named = named_pictures(pictures)

    def grey_of(view: View) -> Float[np.ndarray, "h w"]:
        camera = cameras[view.camera]
        shot = of_one_moment(shots[view.shot], camera)
        image = delivered(named[camera][shot])
        if isinstance(image, Detection):
            raise InputError(_no_picture(camera, shot))
        return grey_image(np.asarray(image)).grey

    return grey_of


def fit_pixels(fit: RobustFit, grey_of: GreyOfView) -> PixelFit:
    """Go on from the fit of points, looking at the pictures as often as the lenses change."""
    problem, silent = _with_own_sigmas(fit.problem), []
    drawn = _drawn(problem, grey_of)
    for _ in range(_MOST_ROUNDS):
        views, silent = _shown_views(problem, drawn, grey_of)
        problem = problem._replace(views=views)
        before = errors_px(problem)
        problem, _ = fitted(without_wrong_circles(fitted(problem)[0]))
        moves = [
            np.sqrt(np.mean((after - then) ** 2))
            for after, then, view in zip(errors_px(problem), before, views, strict=True)
            if view.used.any()
        ]
        if max(moves, default=0.0) < _STILL_PX:
            break
    return PixelFit(judged_fit(problem, fit.moved), silent)


def _drawn(problem: Problem, grey_of: GreyOfView) -> Pattern | SquareSheet:
    """The board's ink."""
    board = problem.target
    if isinstance(board, Pattern):
        return board
    if isinstance(board, AprilGrid):
        return square_sheet(board, quarters=quarters_of_tags(problem, board, grey_of))
    return square_sheet(board)


def _with_own_sigmas(problem: Problem) -> Problem:
    """The problem with the factors of its cameras' points in the covariances of these."""
    views = []
    for view in problem.views:
        variance = problem.sigma_factor[view.camera] ** 2
        views.append(view._replace(detection=_scaled(view.detection, variance)))
    ones = np.ones_like(problem.sigma_factor)
    return problem._replace(views=tuple(views), sigma_factor=ones)


def _scaled(detection: Detection, variance: float) -> Detection:
    return eqx.tree_at(lambda d: d.covariance_px2, detection, detection.covariance_px2 * variance)


def _shown_views(
    problem: Problem, drawn: Pattern | SquareSheet, grey_of: GreyOfView
) -> tuple[tuple[View, ...], list[tuple[int, int, str]]]:
    """The views with what their pictures show, given the rig as it is."""
    asked = {str(k): view for k, view in enumerate(problem.views) if view.used.any()}
    poses, lenses, shifts = {}, {}, {}
    for name, view in asked.items():
        board = np.asarray(problem.state.rig_from_board)[view.shot]
        pose = chained(np.asarray(problem.state.cam_from_rig)[view.camera], board)
        poses[name] = Pose(pose)
        lenses[name] = lens_number(problem, int(problem.chart.lens_of_camera[view.camera]))
        shift = shift_of_places(problem, lenses[name], pose)
        if shift is not None:
            shifts[name] = shift
    told, names = {}, list(asked)
    for part in blocks(len(names), _PICTURES_AT_ONCE):
        pictures = {name: grey_of(asked[name]) for name in names[part]}
        own = {name: poses[name] for name in names[part]}
        told |= refine_views(pictures, own, drawn, lenses, PoseModel.RIGID, shifts)
    views, silent = list(problem.views), []
    for name, view in asked.items():
        one = told[name]
        views[int(name)] = view._replace(shown=one.points)
        if one.points is None:
            silent.append((view.camera, view.shot, one.note or ""))
    return tuple(views), silent
