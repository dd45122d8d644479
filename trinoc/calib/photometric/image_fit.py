"""From a pose that the circles gave to the one that explains the picture itself."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric.covariance import PoseCovariance, pose_covariance, spread_of_values
from trinoc.calib.photometric.encoding import AS_DELIVERED, Encoding
from trinoc.calib.photometric.evidence import find_refuted_part
from trinoc.calib.photometric.fit import (
    fit_delivered_camera,
    fit_ideal_camera,
    refit_ideal_camera,
)
from trinoc.calib.photometric.fit_state import PictureFitState
from trinoc.calib.photometric.noise import inflation, noise_by_level
from trinoc.calib.photometric.patches import patch_points
from trinoc.calib.photometric.scene import (
    PixelScene,
    ShiftOfPlaces,
    blocks_of_pixels,
    scene_of_picture,
)
from trinoc.calib.photometric.unknowns import PictureState
from trinoc.calib.problem.views import SheetPoints
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.image.response import PowerResponse

# numerical: tolerance of the fit of an ideal camera: the gain of chi-square that the step promises
# which would come next, the square of its length in standard deviations.
_CONVERGED_GAIN = 0.3**2
# numerical: for words only: said from so many standard deviations on, and from these amounts on.
_SIGMAS, _LEAST_BEND, _LEAST_LOBE, _LEAST_MOTION_PX = 4.0, 0.03, 0.03, 0.5
# numerical: for words only.
_LEAST_INFLATION, _SATURATED_SHARE = 1.2, 0.01


class ImageRefinement(NamedTuple):
    """The fit of one picture, before anybody has judged it.

    Fields
    ------
    state : where it ended.
    information : (p, p) of a step of the pose, lengths in units of its distance, after the other
        unknowns have taken their share, for noise as neighbours share it.
    noise : standard deviation of a pixel at the grey level between paper and ink.
    noise_floor : the same of the picture's flat parts; `noise` itself of a delivered picture,
        whose noise depends on the grey level.
    pixels : number of pixels that stayed.
    pixels_cut : number of pixels near an edge that show something else than the sheet.
    converged : whether the last step was small against its own standard deviation.
    points : where the picture shows each circle and each piece of the crossed lines.
    found : what the picture shows of its camera and its light, in words; nothing where an ideal
        camera explains it.
    overshoot : amplitude of the sharpening that the profiles of edges show; 0 where none is sure.
    """

    state: PictureState
    information: Float[np.ndarray, "p p"]
    noise: float
    noise_floor: float
    pixels: int
    pixels_cut: int
    converged: bool
    points: SheetPoints
    found: tuple[str, ...] = ()
    overshoot: float = 0.0


def refine_image(
    image: Float[np.ndarray, "h w"],
    pattern: Pattern | SquareSheet,
    lens: AbstractLens,
    start: Pose,
    model: PoseModel,
    *,
    shift: ShiftOfPlaces | None = None,
    encoding: Encoding = AS_DELIVERED,
    tuning: PhotometricTuning = TUNING.photometric,
) -> ImageRefinement | None:
    """Fit the sheet's model to the pixels near its edges; None where none can be seen.

    An ideal camera comes first; where its residuals refute it, its unknowns are freed.

    shift : how far aside of where the lens and a flat sheet would have them, in px, the picture
        shows places of the sheet.
    encoding : how grey levels stand for light; where it is said, the camera is not ideal.
    tuning : constants of the fit.
    """
    posed = scene_of_picture(image, pattern, lens, start, model, shift, encoding, tuning)
    ideal = None if posed is None else fit_ideal_camera(*posed)
    if posed is None or ideal is None:
        return None
    scene, (robust, point) = posed[0], ideal

    def refinement(
        scene: PixelScene,
        point: PictureFitState,
        covariance: PoseCovariance,
        found: tuple[str, ...],
    ) -> ImageRefinement:
        points = patch_points(lens, pattern, scene, point, covariance.inflation)
        if shift is not None:
            points = points._replace(uv_px=points.uv_px + shift(points.point_mm))
        noise = _noise_in_the_middle(point) * float(np.sqrt(covariance.chi_square))
        return ImageRefinement(
            point.state,
            _inverse(covariance.matrix),
            noise,
            scene.noise_floor if point.state.unknowns.is_ideal else noise,
            int(point.kept.sum()),
            int(np.sum(~point.kept)),
            not point.state.unknowns.is_ideal or point.promised < _CONVERGED_GAIN,
            points,
            found,
            _overshoot(scene, point),
        )

    residual = point.level - scene.grey
    is_said = encoding.bayer is not None or bool(encoding.bend)
    refuted = "model" if is_said else find_refuted_part(scene, point)
    if refuted == "noise":
        sigma = noise_by_level(point.level, residual, point.kept, point.level, tuning.fewest_pixels)
        point = refit_ideal_camera(scene, point.with_pixels(sigma=sigma))
    if refuted == "model":
        blocks = blocks_of_pixels(scene.chosen, start, lens, pattern)
        wider = scene._replace(blocks=blocks)
        fitted = fit_delivered_camera(wider, robust.state, start)
        if fitted is not None:
            wider, delivered = fitted
            covariance = pose_covariance(wider, delivered, correlated=True)
            if np.isfinite(covariance.matrix).all():
                found = describe_processing(wider, delivered, covariance)
                return refinement(wider, delivered, covariance, found)
    return refinement(scene, point, pose_covariance(scene, point, correlated=False), ())


def _overshoot(scene: PixelScene, point: PictureFitState) -> float:
    """The lobe beside edges that sharpening makes, where it is surely there; else 0."""
    look = point.state.unknowns.look
    if "lobe" not in look:
        return 0.0
    row = look.index("lobe")
    value, sigma = float(point.state.values[row]), float(spread_of_values(scene, point)[row])
    return value if value > _SIGMAS * sigma > 0 else 0.0


def _noise_in_the_middle(point: PictureFitState) -> float:
    half = float(point.state.light[0] * (1 + 0.5 * point.state["ratio"]))
    near = np.argsort(np.abs(point.level - half))[: max(len(point.level) // 50, 1)]
    return float(np.median(point.sigma[near]))


def _inverse(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    if not np.isfinite(covariance).all():
        return covariance
    return np.linalg.pinv(covariance, hermitian=True)


def describe_processing(
    scene: PixelScene, point: PictureFitState, covariance: PoseCovariance
) -> tuple[str, ...]:
    """Sentences' halves such as "sharpened" or "saturated paper", the surest only."""
    look = point.state.unknowns.look
    value = dict(zip(look, map(float, point.state.values), strict=False))
    sigma = dict(zip(look, map(float, spread_of_values(scene, point)), strict=False))
    sure = {name for name in look if 0 < _SIGMAS * sigma[name] < abs(value[name])}
    said, bend = [], value["bend"]
    if scene.bend is None and abs(bend) > max(_SIGMAS * sigma["bend"], _LEAST_BEND):
        spread = f"({bend:.2f} +- {sigma['bend']:.2f}, 0 linear, 1 sRGB)"
        curve = f"{PowerResponse(bend).description} {spread}"
        said.append(f"response {curve}")
    if "contrast" in sure:
        said.append("response with an s-curve")
    if "lobe" in sure and value["lobe"] > _LEAST_LOBE:
        said.append(f"sharpened ({value['lobe']:.2f})")
    elif "lobe" in sure and value["lobe"] < -_LEAST_LOBE:
        said.append("blur with wide tails")
    if "kurtosis" in sure and value["kurtosis"] < 0:
        said.append("blur with a flat top")
    along, across = value["along_u"], value["diagonal"]
    said += _motion(along, across, max(sigma["along_u"], sigma["diagonal"]))
    if np.mean(scene.grey >= scene.top - 0.5) > _SATURATED_SHARE:
        said.append("saturated paper")
    if scene.local:
        said.append("uneven light")
    if covariance.correlation is not None:
        shared = inflation(covariance.correlation)
        if shared > _LEAST_INFLATION:
            said.append(f"noise that neighbours share ({shared:.1f} times the variance)")
    return tuple(said)


def _motion(along: float, across: float, sigma: float) -> list[str]:
    amount = float(np.hypot(along, across))
    # A line of even light has length^2 / 12 of variance, half of it in the anisotropy.
    length = float(np.sqrt(24 * amount))
    if amount < _SIGMAS * sigma or length < _LEAST_MOTION_PX or amount == 0:
        return []
    angle = float(np.degrees(np.arctan2(across, along)) / 2) % 180
    return [f"moved by {length:.1f} px at {angle:.0f} degrees"]
