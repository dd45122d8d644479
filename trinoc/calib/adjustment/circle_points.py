"""From the centres of ellipses to where the picture shows the centres of circles.

The two differ by a tenth of a pixel, and by a thousandth more or less where the sheet bends or the
lens is another than was said: as much as the mean of all circles is known to.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.estimate import Adjustment
from trinoc.calib.adjustment.sheet_shape import point_of_place
from trinoc.calib.detection import Detection
from trinoc.calib.model import (
    CircleObservations,
    SheetPoints,
    bucket_size,
    circle_observations,
    predicted_centre_px,
)
from trinoc.calib.targets import Pattern
from trinoc.geometry import (
    AbstractLens,
    Pose,
    centre_of_mapped_ellipse,
    dual_conic_of_circle,
    project_point,
)
from trinoc.numerics import ArrayLike


def points_before_flat_sheet(
    detection: Detection, pattern: Pattern, pose: Pose, lens: AbstractLens
) -> SheetPoints:
    """The centres of a detection's circles, if the camera is at `pose` and the sheet is flat."""
    circles = circle_observations(detection, pattern, bucket_size(len(detection)))
    return _points(
        detection, circles, np.asarray(_eccentricities_before_flat_px(pose, lens, circles))
    )


def points_as_adjusted(
    detection: Detection,
    pattern: Pattern,
    adjustment: Adjustment,
    view: int,
    spread_mm: float = 0.0,
) -> SheetPoints:
    """The same for the pose, the lens and the sheet that an adjustment found.

    spread_mm : by which ink reaches beyond the drawing.
    """
    found = adjustment.adjusted
    pose, lens = jax.tree.map(lambda leaf: leaf[view], (found.pose, found.lens))
    circles = circle_observations(detection, pattern, bucket_size(len(detection)))
    apart = _eccentricities_px(
        pose,
        lens,
        found.shape,
        adjustment.reach_mm,
        np.asarray(circles.centres_sheet_mm),
        np.asarray(circles.radius_mm) + spread_mm,
    )
    return _points(detection, circles, np.asarray(apart))


def _points(
    detection: Detection, circles: CircleObservations, apart_px: Float[np.ndarray, "_n 2"]
) -> SheetPoints:
    count = len(detection)
    whitening = np.zeros((count, 2, count, 2))
    each = np.arange(count)
    whitening[each, :, each, :] = circles.whitening[:count]
    return SheetPoints(
        np.asarray(circles.centres_sheet_mm)[:count],
        detection.centres_px - apart_px[:count],
        whitening.reshape(2 * count, 2 * count),
    )


@jax.jit
def _eccentricities_before_flat_px(
    pose: Pose, lens: AbstractLens, circles: CircleObservations
) -> Float[ArrayLike, "n 2"]:
    """Centre of each circle's image less the image of its centre, exactly."""

    def one(place: Float[ArrayLike, "2"], radius: Float[ArrayLike, ""]) -> ArrayLike:
        centre = project_point(pose, lens, jnp.append(place, 0.0))
        return predicted_centre_px(pose, lens, place, radius) - centre

    return jax.vmap(one)(circles.centres_sheet_mm, circles.radius_mm)


@jax.jit
def _eccentricities_px(
    pose: Pose,
    lens: AbstractLens,
    shape: Float[ArrayLike, "s"],
    reach_mm: Float[ArrayLike, ""],
    places_mm: Float[ArrayLike, "n 2"],
    radius_mm: Float[ArrayLike, "n"],
) -> Float[ArrayLike, "n 2"]:
    """Centre of each circle's image less the image of its centre.

    A circle bends with the sheet: what its edge is higher than its middle moves its image by a
    thousandth of a pixel.
    """

    def image(place: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        return project_point(pose, lens, point_of_place(place, shape, reach_mm))

    def one(place: Float[ArrayLike, "2"], radius: Float[ArrayLike, ""]) -> ArrayLike:
        circle = dual_conic_of_circle(place, radius)
        return centre_of_mapped_ellipse(circle, image) - image(place)

    return jax.vmap(one)(places_mm, radius_mm)
