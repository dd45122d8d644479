"""From a pose that the circles gave to the one that explains the picture itself."""

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.model import SheetPoints
from trinoc.calib.photometric.camera_fit import fit_camera
from trinoc.calib.photometric.camera_patches import camera_rows
from trinoc.calib.photometric.encoding import AS_DELIVERED, Encoding
from trinoc.calib.photometric.ideal_fit import IdealFit, fit_ideal_camera, rows_of_ideal
from trinoc.calib.photometric.image_problem import ShiftOfPlaces, camera_scene, image_problem
from trinoc.calib.photometric.image_refinement import (
    ImageRefinement,
    of_extended_model,
    of_ideal_camera,
)
from trinoc.calib.photometric.local_light import blocks_of_pixels
from trinoc.calib.photometric.noise_by_level import noise_by_level
from trinoc.calib.photometric.patches import PixelRows, patch_points
from trinoc.calib.photometric.refutation import refuted_part
from trinoc.calib.targets import Pattern, SquareSheet
from trinoc.geometry import AbstractLens, Pose, PoseModel

# The median of flat parts sees no more noise than the residuals, a mosaic's colours apart.
_MOSAIC_NOISE = 1.5


def refine_image(
    image: Float[np.ndarray, "h w"],
    pattern: Pattern | SquareSheet,
    lens: AbstractLens,
    start: Pose,
    model: PoseModel,
    *,
    shift: ShiftOfPlaces | None = None,
    encoding: Encoding = AS_DELIVERED,
) -> ImageRefinement | None:
    """Fit the sheet's model to the pixels near its edges; None where none can be seen.

    An ideal camera's model comes first; where its residuals refute it, the extended one.

    shift : how far aside of where the lens and a flat sheet would have them, in px, the picture
        shows places of the sheet.
    encoding : how grey levels stand for light; with a response of sRGB the extended model is
        fitted at once.
    """
    posed = image_problem(image, pattern, lens, start, model, shift, encoding)
    if posed is None:
        return None
    problem, noise_floor = posed
    ideal = fit_ideal_camera(problem)
    if ideal is None:
        return None

    def shown(homography: np.ndarray, pixels: PixelRows) -> SheetPoints:
        points = patch_points(lens, pattern, homography, pixels)
        if shift is None:
            return points
        return points._replace(uv_px=points.uv_px + shift(points.place_mm))

    def simple(fit: IdealFit) -> ImageRefinement:
        return of_ideal_camera(fit, noise_floor, shown(*rows_of_ideal(fit)))

    left, kept = ideal.residuals, ideal.kept
    if noise_floor > _MOSAIC_NOISE * float(np.sqrt(np.mean(left[kept] ** 2))):
        # Flat parts are noisier than what the fit leaves over: neighbours differ by colour.
        return simple(ideal)._replace(found=("a raw mosaic of colours",))
    scene = camera_scene(problem, encoding)
    is_ideal = encoding.bayer is None and not encoding.bend
    look = ideal.state.appearance
    refuted = refuted_part(scene, look, left, kept, noise_floor) if is_ideal else "model"
    if refuted == "noise":
        sigma = noise_by_level(scene.grey + left, left, kept, scene.grey + left)
        ideal = ideal.reweighted(np.mean(sigma[kept] ** -2) ** -1 / sigma**2)
    if refuted != "model":
        return simple(ideal)
    blocks = blocks_of_pixels(scene.uv_px, start, lens, pattern)
    extended = fit_camera(scene, jax.tree.map(np.asarray, ideal.robust.state), start, blocks)
    if extended is None or not np.isfinite(extended.covariance).all():
        return simple(ideal)
    points = shown(*camera_rows(scene, problem.everything, extended))
    return of_extended_model(scene, extended, points)
