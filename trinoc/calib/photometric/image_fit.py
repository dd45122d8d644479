"""Fit of one image: from the pose by circles to the pose by grey levels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric import sentences
from trinoc.calib.photometric.covariance import PoseCovariance, pose_covariance, spread_of_values
from trinoc.calib.photometric.encoding import AS_DELIVERED, Encoding
from trinoc.calib.photometric.evidence import find_refuted_part
from trinoc.calib.photometric.fit import (
    fit_full_camera,
    fit_ideal_camera,
    refit_ideal_camera,
)
from trinoc.calib.photometric.fit_state import ImageFitState
from trinoc.calib.photometric.noise import inflation, noise_by_level
from trinoc.calib.photometric.patches import patch_points
from trinoc.calib.photometric.scene import (
    ImageShift,
    PixelScene,
    blocks_of_pixels,
    build_scene,
)
from trinoc.calib.photometric.unknowns import ImageState
from trinoc.calib.problem.views import SheetPoints
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose, PoseModel

# numerical: tolerance of the fit of an ideal camera: predicted gain of chi-square by the next step,
# the square of its length in standard deviations.
_CONVERGED_GAIN = 0.3**2
# numerical: messages only: an effect is reported above these significances and amounts.
_SIGMAS, _LEAST_BEND, _LEAST_LOBE, _LEAST_MOTION_PX = 4.0, 0.03, 0.03, 0.5
# numerical: messages only, as above.
_LEAST_INFLATION, _SATURATED_SHARE = 1.2, 0.01


class ImageRefinement(NamedTuple):
    """Result of the fit to the grey levels of one image, before its validation.

    Attributes
    ----------
    state : values of the unknowns.
    information : (p, p) inverse covariance of a small step of the pose: angles in radians, lengths
        divided by the camera's distance. It includes the uncertainty of all other unknowns and the
        correlation of the noise.
    noise : standard deviation of a pixel at the grey level half-way between paper and ink.
    noise_floor : standard deviation of a pixel in flat parts of the image; equal to `noise` for the
        full camera model.
    pixels : number of inlier pixels.
    pixels_cut : number of outlier pixels near edges.
    converged : True if the last step was small compared with its standard deviation.
    points : image positions of each circle and each piece of the crossed lines.
    effects : short descriptions of the camera's processing and of the light; empty for an ideal
        camera.
    overshoot : amplitude of the sharpening at edges; 0 if it is not significant.
    """

    state: ImageState
    information: Float[np.ndarray, "p p"]
    noise: float
    noise_floor: float
    pixels: int
    pixels_cut: int
    converged: bool
    points: SheetPoints
    effects: tuple[str, ...] = ()
    overshoot: float = 0.0


def refine_image(
    image: Float[np.ndarray, "h w"],
    pattern: Pattern | SquareSheet,
    lens: AbstractLens,
    start: Pose,
    model: PoseModel,
    *,
    shift: ImageShift | None = None,
    encoding: Encoding = AS_DELIVERED,
    tuning: PhotometricTuning = TUNING.photometric,
) -> ImageRefinement | None:
    """Fit a model of the sheet's image to the grey levels near edges of ink.

    The ideal camera is fitted first. If its residuals contradict it, further unknowns are
    estimated.

    Parameters
    ----------
    image : grey levels.
    pattern : the sheet, or the raster of a board of squares.
    lens : lens, which is assumed exact.
    start : initial pose.
    model : parameters of the pose that are estimated.
    shift : function that returns the known displacement in the image, px, of points of the sheet,
        mm. The cause is a bent sheet or a lens error. None for no displacement.
    encoding : known response and Bayer pattern. With a known nonlinear response or a mosaic, the
        ideal camera is not used.
    tuning : constants of the fit.

    Returns
    -------
    Result of the fit; None if the visible edges are too few or their contrast is too low.
    """
    initial = build_scene(image, pattern, lens, start, model, shift, encoding, tuning)
    ideal = None if initial is None else fit_ideal_camera(*initial)
    if initial is None or ideal is None:
        return None
    scene, (robust, fit_state) = initial[0], ideal

    def refinement(
        scene: PixelScene,
        fit_state: ImageFitState,
        covariance: PoseCovariance,
        effects: tuple[str, ...],
    ) -> ImageRefinement:
        points = patch_points(lens, pattern, scene, fit_state, covariance.inflation)
        if shift is not None:
            points = points._replace(uv_px=points.uv_px + shift(points.point_mm))
        noise = _noise_at_half_level(fit_state) * float(np.sqrt(covariance.chi_square))
        return ImageRefinement(
            fit_state.state,
            _inverse(covariance.matrix),
            noise,
            scene.noise_floor if fit_state.state.unknowns.is_ideal else noise,
            int(fit_state.inliers.sum()),
            int(np.sum(~fit_state.inliers)),
            not fit_state.state.unknowns.is_ideal or fit_state.predicted_gain < _CONVERGED_GAIN,
            points,
            effects,
            _overshoot(scene, fit_state),
        )

    residual = fit_state.level - scene.grey
    is_not_ideal = encoding.bayer is not None or bool(encoding.response_bend)
    refuted = "model" if is_not_ideal else find_refuted_part(scene, fit_state)
    if refuted == "noise":
        sigma = noise_by_level(
            fit_state.level, residual, fit_state.inliers, fit_state.level, tuning.fewest_pixels
        )
        fit_state = refit_ideal_camera(scene, fit_state.with_pixels(sigma=sigma))
    if refuted == "model":
        blocks = blocks_of_pixels(scene.pixels, start, lens, pattern)
        fitted = fit_full_camera(scene._replace(blocks=blocks), robust.state, start)
        if fitted is not None:
            full_scene, full_fit = fitted
            covariance = pose_covariance(full_scene, full_fit, correlated=True)
            if np.isfinite(covariance.matrix).all():
                effects = describe_processing(full_scene, full_fit, covariance)
                return refinement(full_scene, full_fit, covariance, effects)
    return refinement(scene, fit_state, pose_covariance(scene, fit_state, correlated=False), ())


def _overshoot(scene: PixelScene, fit_state: ImageFitState) -> float:
    """Amplitude of the sharpening at edges if it is significant; else 0."""
    names = fit_state.state.unknowns.appearance
    if "lobe" not in names:
        return 0.0
    row = names.index("lobe")
    value, sigma = (
        float(fit_state.state.values[row]),
        float(spread_of_values(scene, fit_state)[row]),
    )
    return value if value > _SIGMAS * sigma > 0 else 0.0


def _noise_at_half_level(fit_state: ImageFitState) -> float:
    """Median noise of the pixels whose level is nearest to the middle between paper and ink."""
    half = float(fit_state.state.light[0] * (1 + 0.5 * fit_state.state["ratio"]))
    nearest = np.argsort(np.abs(fit_state.level - half))[: max(len(fit_state.level) // 50, 1)]
    return float(np.median(fit_state.sigma[nearest]))


def _inverse(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    if not np.isfinite(covariance).all():
        return covariance
    return np.linalg.pinv(covariance, hermitian=True)


def describe_processing(
    scene: PixelScene, fit_state: ImageFitState, covariance: PoseCovariance
) -> tuple[str, ...]:
    """Return short descriptions of significant effects, such as "uneven light".

    Parameters
    ----------
    scene : pixels and constants of the fit.
    fit_state : end of the fit of the full camera model.
    covariance : covariance of the pose, with the correlation of the noise.
    """
    names = fit_state.state.unknowns.appearance
    value = dict(zip(names, map(float, fit_state.state.values), strict=False))
    sigma = dict(zip(names, map(float, spread_of_values(scene, fit_state)), strict=False))
    significant = {name for name in names if 0 < _SIGMAS * sigma[name] < abs(value[name])}
    effects, response_bend = [], value["bend"]
    if scene.response_bend is None and abs(response_bend) > max(
        _SIGMAS * sigma["bend"], _LEAST_BEND
    ):
        effects.append(sentences.response_of(response_bend, sigma["bend"]))
    if "contrast" in significant:
        effects.append(sentences.S_CURVE)
    if "lobe" in significant and value["lobe"] > _LEAST_LOBE:
        effects.append(sentences.sharpened(value["lobe"]))
    elif "lobe" in significant and value["lobe"] < -_LEAST_LOBE:
        effects.append(sentences.WIDE_TAILS)
    if "kurtosis" in significant and value["kurtosis"] < 0:
        effects.append(sentences.FLAT_TOP)
    along, across = value["along_u"], value["diagonal"]
    effects += _motion(along, across, max(sigma["along_u"], sigma["diagonal"]))
    if np.mean(scene.grey >= scene.top - 0.5) > _SATURATED_SHARE:
        effects.append(sentences.SATURATED)
    if scene.has_local_light:
        effects.append(sentences.UNEVEN_LIGHT)
    if covariance.correlation is not None:
        factor = inflation(covariance.correlation)
        if factor > _LEAST_INFLATION:
            effects.append(sentences.correlated_noise(factor))
    return tuple(effects)


def _motion(along: float, across: float, sigma: float) -> list[str]:
    """Return the description of a motion blur in a list, which is empty if it is not significant.

    along, across : anisotropy of the blur, px^2: (variance along u - variance along v) / 2, and
        covariance of u and v.
    sigma : standard deviation of `along` and `across`.
    """
    amount = float(np.hypot(along, across))
    # A uniform distribution on a line has the variance length^2 / 12; half of it is anisotropy.
    length = float(np.sqrt(24 * amount))
    if amount < _SIGMAS * sigma or length < _LEAST_MOTION_PX or amount == 0:
        return []
    angle = float(np.degrees(np.arctan2(across, along)) / 2) % 180
    return [sentences.moved(length, angle)]
