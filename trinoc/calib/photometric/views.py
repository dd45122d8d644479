"""From judged circle fits to fits of the pictures themselves."""

import functools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection import Detection
from trinoc.calib.model import bucket_size, circle_observations, circle_residuals_px
from trinoc.calib.photometric.image_fit import ImageRefinement, refine_image
from trinoc.calib.pose import DEGREES, PoseEstimate, pose_of_values, values_of_parameters
from trinoc.calib.result import ImageQuality, Status
from trinoc.calib.targets import Pattern
from trinoc.geometry import PARAMETER_NAMES, Intrinsics, Pose, PoseModel
from trinoc.numerics import LARGEST_SIGMA, ArrayLike, observability

# The picture moves circles by hundredths of a pixel; more than this is another minimum.
_LARGEST_MOVE_PX = 0.5
# Variance of a pixel's box, which the fitted sigma includes and the lens's blur does not.
_BOX_VARIANCE = 1 / 12

_Answer = TypeVar("_Answer")


class ViewEstimate(NamedTuple):
    """A picture's fit, what its picture says about it, and a sentence where it says nothing."""

    fit: PoseEstimate
    quality: ImageQuality | None
    note: str | None


def refine_views(
    images: Mapping[str, Float[np.ndarray, "_h _w"]],
    fits: Mapping[str, PoseEstimate],
    detections: Mapping[str, Detection],
    pattern: Pattern,
    lenses: Mapping[str, Intrinsics],
    model: PoseModel,
) -> dict[str, ViewEstimate]:
    """Fit each picture from its circles' pose; in threads, since they share nothing.

    A picture that cannot be fitted keeps its circle fit, and a note says so.
    """

    def refine(name: str) -> ViewEstimate:
        return _refine(images[name], fits[name], detections[name], pattern, lenses[name], model)

    return in_threads(refine, list(fits))


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
    """The threads of all fits: what the compiler keeps for each thread is never given back."""
    return ThreadPoolExecutor(thread_name_prefix="trinoc-refine")


def _refine(
    image: Float[np.ndarray, "h w"],
    fit: PoseEstimate,
    detection: Detection,
    pattern: Pattern,
    lens: Intrinsics,
    model: PoseModel,
) -> ViewEstimate:
    refined = refine_image(image, pattern, lens.lens, pose_of_values(fit.values), model)
    if refined is None:
        return ViewEstimate(fit, None, "the picture has too little contrast to be fitted itself.")
    if not refined.converged or not np.isfinite(refined.information).all():
        return ViewEstimate(fit, None, "the fit of the picture itself did not converge.")
    circles = circle_observations(detection, pattern, bucket_size(len(detection)))
    residuals_px = np.asarray(_circle_residuals(refined.pose, lens.lens, circles))[: len(detection)]
    moved = np.abs(residuals_px - fit.residuals_px)[fit.used]
    if not moved.max(initial=0.0) < _LARGEST_MOVE_PX:
        return ViewEstimate(
            fit, None, f"the picture itself disagrees with its circles by {moved.max():.2f} px."
        )
    return _judged(fit, refined, residuals_px, model)


def _judged(
    fit: PoseEstimate, refined: ImageRefinement, residuals_px: np.ndarray, model: PoseModel
) -> ViewEstimate:
    parameters, by_delta = (
        np.asarray(part) for part in _named_parameters(refined.pose, model=model)
    )
    by_delta = DEGREES[: model.size, None] * by_delta
    largest = LARGEST_SIGMA * DEGREES * np.array([1, 1, 1, *np.full(3, parameters[3])])
    seen = observability(refined.information / refined.noise**2, by_delta, largest[: model.size])
    if seen.rank < model.size:
        return ViewEstimate(fit, None, "the picture itself leaves the pose undetermined.")
    look = refined.appearance
    quality = ImageQuality(
        noise=refined.noise,
        noise_floor=refined.noise_floor,
        pixels=refined.pixels,
        pixels_cut=refined.pixels_cut,
        blur_px=float(np.sqrt(max(float(look.sigma_px) ** 2 - _BOX_VARIANCE, 0.0))),
        ink_spread_mm=float(look.spread_mm),
        ink_over_paper=float(1 + look.ratio),
        bound=seen.covariance * (refined.noise_floor / refined.noise) ** 2,
    )
    return ViewEstimate(
        fit._replace(
            status=Status.CONVERGED,
            values=values_of_parameters(parameters),
            covariance=seen.covariance,
            residuals_px=residuals_px,
            rank=seen.rank,
            gauge=tuple(PARAMETER_NAMES[k] for k in seen.gauge),
        ),
        quality,
        None,
    )


_circle_residuals = jax.jit(circle_residuals_px)


@partial(jax.jit, static_argnames="model")
def _named_parameters(
    pose: Pose, *, model: PoseModel
) -> tuple[Float[ArrayLike, "p"], Float[ArrayLike, "p p"]]:
    """Parameters of a pose, and their derivative by a step in units of its distance."""
    by_delta = pose.d_parameters_d_delta(model, pose.distance_mm, pose)
    return pose.model_parameters(model, pose), by_delta
