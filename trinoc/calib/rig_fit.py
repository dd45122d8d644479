"""From sheets that were found to cameras: by circles, then by grey levels that do not scatter."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.agreement import (
    autocorrelation_of_circles,
    probability_of_agreement,
    scatter_of_blocks,
)
from trinoc.calib.adjustment.each_camera import PoseEstimate, fit_camera
from trinoc.calib.adjustment.estimate import Adjustment, adjust_cameras, prior_weights
from trinoc.calib.detection.detection import Detection
from trinoc.calib.photometric.encoding import Encoding
from trinoc.calib.photometric.scene import ShiftOfPlaces
from trinoc.calib.photometric.views import PictureFit, refine_views
from trinoc.calib.problem.apparent_shift import apparent_shift
from trinoc.calib.problem.sheet_problem import SheetCamera
from trinoc.calib.result.calibration import Status
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.tails import normal_limit

Method = Literal["pixels", "points"]


class Knowledge(NamedTuple):
    """What is known of all cameras before they are fitted.

    Fields
    ------
    pattern : the sheet.
    model : what the user wants to know of each pose.
    systematics : what is not exact.
    encoding : how the pictures' grey levels stand for light.
    """

    pattern: Pattern
    model: PoseModel
    systematics: Systematics
    encoding: Encoding = Encoding()

    @property
    def aim_is_held(self) -> bool:
        """Whether the optical axes meet the origin exactly."""
        return self.model is PoseModel.AIMED and not self.systematics.aim_sigma_mm

    @property
    def fitted_model(self) -> PoseModel:
        """What is free of each pose."""
        return PoseModel.AIMED if self.aim_is_held else PoseModel.AIM_FREE

    @property
    def aim_sigma_mm(self) -> float:
        """Of the prior on the aim; 0 for none."""
        return self.systematics.aim_sigma_mm if self.model is PoseModel.AIMED else 0.0

    def adjust(self, cameras: Sequence[SheetCamera], near: Adjustment | None = None) -> Adjustment:
        """The cameras fitted together under what is known."""
        return adjust_cameras(
            cameras, self.pattern, self.systematics, self.fitted_model, self.aim_sigma_mm, near
        )


class CameraChoice(NamedTuple):
    """Whose answer one camera takes, and why.

    Fields
    ------
    camera : what was found in its picture.
    picture : what its grey levels say; None where they were not looked at.
    method : whose answer it is.
    agreement : probability that both answers differ as they do; NaN where there is one.
    scatter : by how much its circles' blocks scatter beyond their noise.
    """

    camera: SheetCamera
    picture: PictureFit | None
    method: Method
    agreement: float
    scatter: float


class RigFit(NamedTuple):
    """All cameras: how each came to its answer, the answer, and that of the circles alone."""

    cameras: list[CameraChoice]
    adjustment: Adjustment
    of_circles: Adjustment


def fit_circles(
    detection: Detection,
    lens: Intrinsics,
    known: Knowledge,
    image: Float[np.ndarray, "h w"] | None = None,
) -> PoseEstimate:
    """One camera from its circles; with its aim held where that is all they determine."""
    fit = fit_camera(detection, known.pattern, lens, known.fitted_model, image)
    if fit.status is Status.CONVERGED or known.model is known.fitted_model:
        return fit
    return fit_camera(detection, known.pattern, lens, known.model, image)


def fit_rig(cameras: Sequence[SheetCamera], known: Knowledge) -> RigFit:
    """All cameras adjusted together, each by its picture where that agrees with its circles.

    cameras : at poses that their circles determine.
    """
    of_circles = known.adjust(cameras)
    pictures = _fit_pictures(cameras, of_circles, known)
    spreads_mm = [
        picture.quality.ink_spread_mm if picture and picture.quality else 0.0
        for picture in pictures
    ]
    if max(map(abs, spreads_mm)) > TUNING.answer.least_spread_mm:
        # Larger circles are seen with their centres further aside.
        pairs = zip(cameras, spreads_mm, strict=True)
        cameras = [camera._replace(ink_spread_mm=spread) for camera, spread in pairs]
        of_circles = known.adjust(cameras, of_circles)
    # What its own pixels left out is no place that may be wrong.
    either = [
        camera if picture is None else camera._replace(shown=picture.points)
        for camera, picture in zip(cameras, pictures, strict=True)
    ]
    is_shown = any(camera.shown is not None for camera in either)
    of_pictures = known.adjust(either, of_circles) if is_shown else of_circles
    choices = [
        choose_answer(k, camera, picture, of_circles, of_pictures)
        for k, (camera, picture) in enumerate(zip(either, pictures, strict=True))
    ]
    final = of_pictures if any(one.method == "pixels" for one in choices) else of_circles
    # Some cameras by their pictures and some not, or circles that know less than they say.
    if len({one.method for one in choices}) > 1 or max(one.scatter for one in choices) > 1.0:
        views = [
            one.camera if one.method == "pixels" else _scale_sigmas(camera, one.scatter)
            for one, camera in zip(choices, cameras, strict=True)
        ]
        final = known.adjust(views, of_circles)
    return RigFit(choices, final, of_circles)


def choose_answer(
    view: int,
    camera: SheetCamera,
    picture: PictureFit | None,
    of_circles: Adjustment,
    of_pictures: Adjustment,
) -> CameraChoice:
    """Choose the answer of one camera: its grey levels, or its circles where those mislead."""
    is_shown = camera.shown is not None
    agreement = float("nan")
    if is_shown:
        agreement = probability_of_agreement(of_circles, of_pictures, view)
    agrees = agreement >= TUNING.answer.chance_of_answers
    is_consistent = is_shown and of_pictures.enlarged[view] == 1.0
    # Shadows, uneven light and blur move circles alike, so that these agree among themselves; what
    # the grey levels do not model makes their places scatter. Filters of phones move whole edges,
    # which an open lens or sheet absorbs: there the circles count, unless neighbouring ones are
    # displaced alike, as by glare.
    may_mislead = picture is not None and picture.is_processed and has_open_model(of_circles)
    if may_mislead and not are_circles_displaced(of_circles, view):
        believes_pixels = agrees and is_consistent
    else:
        believes_pixels = agrees or is_consistent
    if believes_pixels:
        return CameraChoice(camera, picture, "pixels", agreement, 1.0)
    scatter = scatter_of_blocks(of_circles, view)
    # By all that blocks say where the model is wrong.
    scatter = scatter if is_shown or scatter > TUNING.answer.largest_scatter else 1.0
    return CameraChoice(camera, picture, "points", agreement, scatter)


def has_open_model(adjustment: Adjustment) -> bool:
    """Whether lens or sheet are estimated along with the poses."""
    slices, weights = adjustment.problem.slices, prior_weights(adjustment.problem)
    return bool(weights[slices.lenses].any() or weights[slices.sheets].any())


def are_circles_displaced(of_circles: Adjustment, view: int) -> bool:
    """Whether neighbouring circles share errors, as under glare: their blocks scatter, or their
    residuals are correlated."""
    if scatter_of_blocks(of_circles, view) > TUNING.answer.largest_scatter:
        return True
    limit = float(normal_limit(TUNING.answer.chance_of_answers))
    return autocorrelation_of_circles(of_circles, view) > limit


def _fit_pictures(
    cameras: Sequence[SheetCamera], of_circles: Adjustment, known: Knowledge
) -> list[PictureFit | None]:
    """The fit of each picture that is there, around what the circles show of bend and lens."""
    looked_at = {
        camera.name: (k, camera) for k, camera in enumerate(cameras) if camera.image is not None
    }
    shifts: dict[str, ShiftOfPlaces] = {}
    for name, (k, camera) in looked_at.items():
        view = of_circles.problem.views[k]
        shift = apparent_shift(of_circles.problem, view, camera.pose, camera.lens.lens)
        places_mm = known.pattern.centres_mm[camera.detection.circle_index]
        if np.abs(shift(places_mm)).max() > TUNING.answer.least_shift_px:
            shifts[name] = shift
    found = refine_views(
        {name: camera.image for name, (_, camera) in looked_at.items() if camera.image is not None},
        {name: camera.pose for name, (_, camera) in looked_at.items()},
        known.pattern,
        {name: camera.lens.lens for name, (_, camera) in looked_at.items()},
        known.fitted_model,
        shifts,
        known.encoding,
    )
    return [found.get(camera.name) for camera in cameras]


def _scale_sigmas(camera: SheetCamera, scatter: float) -> SheetCamera:
    """The camera by its circles, whose sigmas are `scatter` times as large."""
    return camera._replace(detection=camera.detection.with_larger_sigmas(scatter))
