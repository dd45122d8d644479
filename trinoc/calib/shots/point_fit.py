"""The fit of the places that were detected, by the lens that is asked for or called for."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trinoc.calib.detection import Detection
from trinoc.calib.problem.information import information_of
from trinoc.calib.problem.problem import Freedom, Problem
from trinoc.calib.problem.robust_fit import RobustFit, fit_robustly
from trinoc.calib.problem.score_test import ScoreTest, rational_lens_test, wider_lens_test
from trinoc.calib.problem.shot_scatter import shot_scatter
from trinoc.calib.problem.starting_problem import problem_of
from trinoc.calib.shots.lens_choice import (
    LensChoice,
    asked_for,
    choice_sentence,
    chosen_lens,
    held_out,
)
from trinoc.calib.shots.lens_correction import splined_problem, with_correction
from trinoc.calib.shots.lens_start import CameraStart, camera_start
from trinoc.calib.shots.placing import PlacedRig, ShotBoard, placed_rig
from trinoc.calib.targets import AbstractTarget
from trinoc.calib.uncertainty import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import (
    AFFINE_PARAMETERS,
    AbstractLens,
    AbstractSplined,
    BrownConrady,
    Intrinsics,
    promoted,
)


class Asked(NamedTuple):
    """What is to be fitted: the detections of each camera by shot and board, the names of all
    shots, and what `calibrate_rig` was told of board and lenses."""

    detections: Mapping[str, Mapping[ShotBoard, Detection]]
    shots: Sequence[str]
    target: AbstractTarget
    known: Mapping[str, Intrinsics]
    distortion: int | None
    same_lens: bool
    systematics: Systematics


class PointFit(NamedTuple):
    """The first lenses, the rig where the fit began, and where it ended."""

    starts: Mapping[str, CameraStart]
    placed: PlacedRig
    fit: RobustFit


def fit_of_lens(
    asked: Asked, models: Sequence[type[AbstractLens]], correction: bool | None = False
) -> tuple[PointFit, str | None]:
    """The fit by the one model, or by that of several which the shots call for, and why.

    correction : whether the best of several is corrected by splines; None where the shots ask.

    Raises CalibrationError where no model places the cameras.
    """
    if len(models) == 1:
        return _fitted(asked, models[0]), None
    fits, errors = {}, []
    for model in models:
        try:
            fits[model.model] = _fitted(asked, model)
        except CalibrationError as error:
            errors.append(error)
    if not fits:
        raise errors[0]
    cameras = tuple(asked.detections)
    tried = {name: held_out(each.fit.problem, each.placed, cameras) for name, each in fits.items()}
    choice = chosen_lens(tried)
    best, rational, spline = fits[choice.model], None, _correction_test(asked, fits[choice.model])
    if choice.model == BrownConrady.model:
        rational = rational_lens_test(best.fit.problem, _sizes(asked), _factor(best))
    if correction or (correction is None and asked_for(spline)):
        wider = _corrected(asked, best)
        name = wider.fit.problem.state.lenses.model
        tried[name] = held_out(wider.fit.problem, wider.placed, cameras)
        among = chosen_lens({choice.model: tried[choice.model], name: tried[name]})
        rms_px = {**choice.rms_px, **among.rms_px}
        choice = LensChoice(name if correction else among.model, rms_px)
        best = wider if choice.model == name else best
    return best, choice_sentence(choice, rational, spline)


def _correction_test(asked: Asked, point_fit: PointFit) -> ScoreTest:
    """Whether the shots ask for splines. That they disagree is not taken off, since a lens that is
    not described makes them: shots held out tell it from a board that bends."""
    problem = point_fit.fit.problem
    return wider_lens_test(problem, splined_problem(problem, _sizes(asked)), 1.0)


def _factor(point_fit: PointFit) -> float:
    return shot_scatter(information_of(point_fit.fit.problem)).variance_factor


def _corrected(asked: Asked, point_fit: PointFit) -> PointFit:
    if isinstance(point_fit.fit.problem.state.lenses, AbstractSplined):
        return point_fit
    return point_fit._replace(fit=with_correction(point_fit.fit, _sizes(asked)))


def _fitted(asked: Asked, model: type[AbstractLens]) -> PointFit:
    if issubclass(model, AbstractSplined):
        core = _fitted(asked, model.core_model)
        return core if asked.distortion is not None else _corrected(asked, core)
    starts = {}
    for camera, own in asked.detections.items():
        given = asked.known.get(camera)
        _expect_size(camera, given, next(iter(own.values())))
        try:
            starts[camera] = camera_start(
                list(own.values()), asked.target, model, None if given is None else given.lens
            )
        except CalibrationError as error:
            raise CalibrationError(f'Camera "{camera}": {error}') from error
    placed = placed_rig(starts, asked.detections, asked.shots, asked.target, asked.known)
    return PointFit(starts, placed, fit_robustly(_problem(asked, placed, starts)))


def _sizes(asked: Asked) -> list[tuple[int, int]]:
    return [next(iter(own.values())).image_size_px for own in asked.detections.values()]


def _expect_size(camera: str, lens: Intrinsics | None, detection: Detection) -> None:
    if lens is None or tuple(lens.image_size_px) == tuple(detection.image_size_px):
        return
    (width, height), (given_width, given_height) = detection.image_size_px, lens.image_size_px
    raise InputError(
        f'The lens of "{camera}" is for pictures of {given_width} x {given_height} px, but its '
        f"pictures have {width} x {height}: see that neither lenses nor folders are exchanged."
    )


def _problem(asked: Asked, placed: PlacedRig, starts: Mapping[str, CameraStart]) -> Problem:
    lenses = [start.lens for start in starts.values()]
    sizes = _sizes(asked)
    models = {type(lens) for lens in lenses if lens.has_distortion}
    if len(models) == 1:
        (only,) = models
        lenses = [promoted(lens, only) for lens in lenses]
    if asked.same_lens:
        if len(set(sizes)) > 1:
            raise InputError("same_lens is asked for, but the cameras' pictures differ in size.")
        middle = np.argsort([float(lens.focal_length_px[0]) for lens in lenses])[len(lenses) // 2]
        lenses, sizes = [lenses[middle]], sizes[:1]
    lens_of_camera = np.zeros(len(starts), dtype=int) if asked.same_lens else np.arange(len(starts))
    names = lenses[0].parameter_names
    fitted = np.arange(len(names)) < len(AFFINE_PARAMETERS) + (
        len(names) if asked.distortion is None else asked.distortion
    )
    held = [camera in asked.known for camera in starts][: len(lenses)]
    free = np.stack([np.zeros(len(names), dtype=bool) if is_held else fitted for is_held in held])
    return problem_of(
        placed.views,
        asked.target,
        lenses,
        placed.cam_from_rig,
        placed.rig_from_board,
        sizes,
        Freedom(lens_of_camera, free),
        asked.systematics,
        placed.set_from_board,
    )
