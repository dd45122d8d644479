"""What the fit of a picture makes of a lens that is a little other than it was told.

The circles' response to the lens has a closed form. The picture's differs from it where the
model cannot follow the lens (a principal point that moves while the aim is held): edges and
lines then pull with their own weights. So the picture is fitted again, with the lens moved.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection import Detection
from trinoc.calib.photometric import ViewEstimate, in_threads, refine_image
from trinoc.calib.pose import DEGREES, pose_of_values
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens, Intrinsics, PoseModel, promoted
from trinoc.numerics import ArrayLike

# Circles move this far at most: within the reach of a linear error, beyond that of rounding.
_LARGEST_STEP_PX = 0.05


def lens_spreads(
    images: Mapping[str, Float[np.ndarray, "_h _w"]],
    refined: Mapping[str, ViewEstimate],
    detections: Mapping[str, Detection],
    pattern: Pattern,
    lenses: Mapping[str, Intrinsics],
    factors: Mapping[str, Float[np.ndarray, "_ _"]],
) -> dict[str, Float[np.ndarray, "_ _"]]:
    """J_lens L: the change of each camera's parameters, degrees and mm, along each direction.

    Of the cameras that have a factor and whose own picture was fitted; a camera whose picture
    cannot be fitted with another lens is left out.
    """
    names = [name for name in factors if name in refined and refined[name].quality is not None]

    def spread(name: str) -> Float[np.ndarray, "p r"] | None:
        return _spread(
            images[name], refined[name], detections[name], pattern, lenses[name], factors[name]
        )

    found = in_threads(spread, names)
    return {name: spread for name, spread in found.items() if spread is not None}


def _spread(
    image: Float[np.ndarray, "h w"],
    refined: ViewEstimate,
    detection: Detection,
    pattern: Pattern,
    lens: Intrinsics,
    factor: Float[np.ndarray, "k r"],
) -> Float[np.ndarray, "p r"] | None:
    count = len(refined.fit.covariance)
    model = PoseModel.AIMED if count == PoseModel.AIMED.size else PoseModel.AIM_FREE
    start, nominal = pose_of_values(refined.fit.values), lens.lens
    if factor[len(nominal.parameter_names) :].any():
        nominal = promoted(nominal)
    factor = factor[: len(nominal.parameter_names)]
    moves_px = _largest_moves_px(nominal, detection.centres_px, factor)
    columns = []
    for direction, move_px in zip(factor.T, np.asarray(moves_px), strict=True):
        step = min(1.0, _LARGEST_STEP_PX / max(float(move_px), 1e-12))
        ends = []
        for sign in (-step, step):
            other = refine_image(image, pattern, nominal.retract(sign * direction), start, model)
            if other is None or not other.converged:
                return None
            ends.append(DEGREES[:count] * np.asarray(other.pose.parameters)[:count])
        change = ends[1] - ends[0]
        change[[0, 2]] = (change[[0, 2]] + 180.0) % 360.0 - 180.0
        columns.append(change / (2 * step))
    return np.stack(columns, axis=1) if columns else np.zeros((count, 0))


@jax.jit
def _largest_moves_px(
    lens: AbstractLens, centres_px: Float[ArrayLike, "m 2"], factor: Float[ArrayLike, "k r"]
) -> Float[ArrayLike, "r"]:
    """How far each direction moves the circle that it moves farthest."""
    rays = jax.vmap(lens.unproject)(centres_px)

    def largest(direction: Float[ArrayLike, "k"]) -> Float[ArrayLike, ""]:
        after = jax.vmap(lens.retract(direction).project_ray)(rays)
        return jnp.max(jnp.linalg.norm(after - centres_px, axis=1))

    return jax.vmap(largest, in_axes=1)(factor)
