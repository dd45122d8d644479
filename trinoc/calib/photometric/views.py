"""Fit of all images of a rig, each from its initial pose, in parallel threads."""

import functools
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric import sentences
from trinoc.calib.photometric.encoding import AS_DELIVERED, Encoding
from trinoc.calib.photometric.image_fit import ImageRefinement, refine_image
from trinoc.calib.photometric.scene import ImageShift
from trinoc.calib.photometric.sheet_geometry import project_to_image
from trinoc.calib.problem.image_quality import ImageQuality
from trinoc.calib.problem.sheet_problem import GreyLevelFit
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose, PoseModel

# numerical: variance of the integration over a pixel, px^2; part of the fitted blur.
_BOX_VARIANCE = 1 / 12

_Result = TypeVar("_Result")


def refine_views(
    images: Mapping[str, Float[np.ndarray, "_h _w"]],
    starts: Mapping[str, Pose],
    pattern: Pattern | SquareSheet,
    lenses: Mapping[str, AbstractLens],
    model: PoseModel,
    shifts: Mapping[str, ImageShift],
    encoding: Encoding = AS_DELIVERED,
    tuning: PhotometricTuning = TUNING.photometric,
) -> dict[str, GreyLevelFit]:
    """Fit the grey levels of each camera's image, from an initial pose.

    Parameters
    ----------
    images, starts, lenses : image, initial pose and lens of each camera, by name.
    pattern : the sheet, or the raster of a board of squares.
    model : parameters of the pose that are estimated.
    shifts : by camera, function that returns known displacements of the sheet's image, px; only for
        cameras with a displacement.
    encoding, tuning : see `trinoc.calib.photometric.image_fit.refine_image`.

    Returns
    -------
    Result of each camera by name; a result contains either image positions or the reason why they
    are missing.
    """

    def refine(name: str) -> GreyLevelFit:
        start, shift = starts[name], shifts.get(name)
        return _refine(images[name], start, pattern, lenses[name], model, shift, encoding, tuning)

    return run_in_threads(refine, list(starts))


def run_in_threads(task: Callable[[str], _Result], names: Sequence[str]) -> dict[str, _Result]:
    """Run a task for each camera, in parallel threads.

    Parameters
    ----------
    task : function of a camera's name; the calls must be independent.
    names : names of the cameras.

    Returns
    -------
    Results by camera name.
    """

    def run(name: str) -> _Result:
        # The precision is a setting of the thread.
        with jax.enable_x64(True):
            return task(name)

    if len(names) < 2:
        return {name: run(name) for name in names}
    return dict(zip(names, _threads().map(run, names), strict=True))


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """Thread pool of all fits, with one thread per core.

    The pool is reused, because the compiler never frees its memory per thread. The fit of an image
    of 16 megapixels needs 300 MB.
    """
    return ThreadPoolExecutor(multiprocessing.cpu_count(), thread_name_prefix="trinoc-refine")


def _refine(
    image: Float[np.ndarray, "h w"],
    start: Pose,
    pattern: Pattern | SquareSheet,
    lens: AbstractLens,
    model: PoseModel,
    shift: ImageShift | None,
    encoding: Encoding,
    tuning: PhotometricTuning,
) -> GreyLevelFit:
    def failure(note: str) -> GreyLevelFit:
        return GreyLevelFit(None, None, note)

    # A threshold displaces edges; the model would attribute this to uneven light.
    if len(np.unique(image[:: len(image) // 8 + 1])) <= 2:
        return failure(sentences.TWO_LEVELS)
    refined = refine_image(
        image, pattern, lens, start, model, shift=shift, encoding=encoding, tuning=tuning
    )
    if refined is None:
        return failure(sentences.TOO_FEW_EDGES)
    is_finite = np.isfinite(refined.information).all() and len(refined.points.point_mm) > 0
    if not refined.converged or not is_finite:
        return failure(sentences.NOT_CONVERGED)
    before, after = (
        np.asarray(project_to_image(pose, lens, pattern.centres_mm))
        for pose in (start, refined.state.pose)
    )
    distance_px = float(np.abs(after - before).max())
    if not distance_px < tuning.largest_move_px:
        return failure(sentences.contradicts_circles(distance_px))
    quality = _quality(refined)
    is_processed = refined.overshoot > tuning.processed_overshoot
    return GreyLevelFit(refined.points, quality, None, is_processed)


def _quality(refined: ImageRefinement) -> ImageQuality:
    state = refined.state
    return ImageQuality(
        noise=refined.noise,
        noise_floor=refined.noise_floor,
        pixels=refined.pixels,
        pixels_cut=refined.pixels_cut,
        blur_px=float(np.sqrt(max(float(state["sigma_px"]) ** 2 - _BOX_VARIANCE, 0.0))),
        ink_spread_mm=float(state["spread_mm"]),
        ink_over_paper=float(1 + state["ratio"]),
        found=refined.effects,
    )
