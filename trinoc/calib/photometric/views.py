"""The pictures of a rig, each fitted from where its circles place the camera."""

import functools
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric.encoding import AS_DELIVERED, Encoding
from trinoc.calib.photometric.image_fit import ImageRefinement, refine_image
from trinoc.calib.photometric.scene import ShiftOfPlaces
from trinoc.calib.photometric.sheet_places import project_to_image
from trinoc.calib.problem.image_quality import ImageQuality
from trinoc.calib.problem.sheet_problem import PictureFit
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose, PoseModel

# numerical: of a pixel's box, which the fitted sigma includes and the lens's blur does not.
_BOX_VARIANCE = 1 / 12

_Answer = TypeVar("_Answer")


def refine_views(
    images: Mapping[str, Float[np.ndarray, "_h _w"]],
    starts: Mapping[str, Pose],
    pattern: Pattern | SquareSheet,
    lenses: Mapping[str, AbstractLens],
    model: PoseModel,
    shifts: Mapping[str, ShiftOfPlaces],
    encoding: Encoding = AS_DELIVERED,
    tuning: PhotometricTuning = TUNING.photometric,
) -> dict[str, PictureFit]:
    """Fit each picture from a first pose; in threads, since they share nothing.

    shifts : of the pictures that show the sheet elsewhere; encoding, tuning : see
        `refine_image`.
    """

    def refine(name: str) -> PictureFit:
        start, shift = starts[name], shifts.get(name)
        return _refine(images[name], start, pattern, lenses[name], model, shift, encoding, tuning)

    return in_threads(refine, list(starts))


def in_threads(task: Callable[[str], _Answer], names: Sequence[str]) -> dict[str, _Answer]:
    """A task of each camera, which share nothing, in threads."""

    def alone(name: str) -> _Answer:
        # The precision is a setting of the thread.
        with jax.enable_x64(True):
            return task(name)

    if len(names) < 2:
        return {name: alone(name) for name in names}
    return dict(zip(names, _threads().map(alone, names), strict=True))


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """The threads of all fits: what the compiler keeps for each thread is never given back.

    One for each core, because a picture of 16 megapixels takes 300 MB while it is fitted.
    """
    return ThreadPoolExecutor(multiprocessing.cpu_count(), thread_name_prefix="trinoc-refine")


def _refine(
    image: Float[np.ndarray, "h w"],
    start: Pose,
    pattern: Pattern | SquareSheet,
    lens: AbstractLens,
    model: PoseModel,
    shift: ShiftOfPlaces | None,
    encoding: Encoding,
    tuning: PhotometricTuning,
) -> PictureFit:
    def silent(note: str) -> PictureFit:
        return PictureFit(None, None, note)

    # A threshold moves each edge as it likes; the model would take that for light.
    if len(np.unique(image[:: len(image) // 8 + 1])) <= 2:
        return silent("the picture has two grey levels alone, and so cannot be fitted itself.")
    refined = refine_image(
        image, pattern, lens, start, model, shift=shift, encoding=encoding, tuning=tuning
    )
    if refined is None:
        return silent(
            "the picture shows too little of the sheet's edges, and so cannot be fitted itself."
        )
    finite = np.isfinite(refined.information).all() and len(refined.points.point_mm) > 0
    if not refined.converged or not finite:
        return silent("the fit of the picture itself did not converge.")
    before, after = (
        np.asarray(project_to_image(pose, lens, pattern.centres_mm))
        for pose in (start, refined.state.pose)
    )
    moved = float(np.abs(after - before).max())
    if not moved < tuning.largest_move_px:
        return silent(f"the picture itself disagrees with its circles by {moved:.2f} px.")
    quality = _quality(refined)
    is_processed = refined.overshoot > tuning.processed_overshoot
    return PictureFit(refined.points, quality, None, is_processed)


def _quality(refined: ImageRefinement) -> ImageQuality:
    look = refined.state
    return ImageQuality(
        noise=refined.noise,
        noise_floor=refined.noise_floor,
        pixels=refined.pixels,
        pixels_cut=refined.pixels_cut,
        blur_px=float(np.sqrt(max(float(look["sigma_px"]) ** 2 - _BOX_VARIANCE, 0.0))),
        ink_spread_mm=float(look["spread_mm"]),
        ink_over_paper=float(1 + look["ratio"]),
        found=refined.found,
    )
