"""One camera's pictures as arrays, and the fit of a lens without circles located wrongly."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection import Detection
from trinoc.calib.intrinsics.lens_fit import LensFit, fit_lens
from trinoc.calib.intrinsics.lens_parameters import LensModel, free_directions
from trinoc.calib.intrinsics.lens_residual import LensChart
from trinoc.calib.intrinsics.zhang import ZhangStart
from trinoc.calib.model import (
    ANNEALING,
    CircleObservations,
    bucket_size,
    circle_observations,
    inliers,
    is_suspect,
    robust_scale,
    stack_observations,
)
from trinoc.calib.targets import Pattern
from trinoc.numerics import as_numpy

# Pictures are padded to a multiple of this, so that one more seldom compiles anew.
_IMAGE_BUCKET = 8


class LensImages(NamedTuple):
    """Pictures of the sheet by one camera.

    Fields
    ------
    detections : one for each picture.
    pattern : the sheet.
    used : for each picture (m,) which of its circles take part.
    """

    detections: Sequence[Detection]
    pattern: Pattern
    used: list[Bool[np.ndarray, "_m"]]

    @property
    def image_size_px(self) -> tuple[int, int]:
        """(width, height) of the pictures."""
        return self.detections[0].image_size_px

    @property
    def observations(self) -> CircleObservations:
        """All circles, padded; unused ones without weight."""
        size = bucket_size(max(len(detection) for detection in self.detections))
        rows = [
            circle_observations(detection, self.pattern, size, used)
            for detection, used in zip(self.detections, self.used, strict=True)
        ]
        empty = rows[0]._replace(whitening=np.zeros_like(rows[0].whitening))
        return stack_observations(rows + [empty] * (-len(rows) % _IMAGE_BUCKET))


def fit_model(
    start: ZhangStart, model: LensModel, images: LensImages, outlier_scale: float = np.inf
) -> LensFit:
    """The lens of one model from a start; coefficients that are not free stay as they are."""
    count = len(images.detections)
    padded = np.minimum(np.arange(count + -count % _IMAGE_BUCKET), count - 1)
    chart = LensChart(
        start.lens,
        start.lens.parameter_scales(images.image_size_px),
        free_directions(model),
        start.cam_from_world[padded],
    )
    fit = as_numpy(fit_lens(chart, images.observations, np.array(outlier_scale)))
    return fit._replace(
        cam_from_world=fit.cam_from_world[:count],
        residuals_px=fit.residuals_px[:count],
        whitened=fit.whitened[:count],
        information=fit.information[:count],
    )


def fit_robustly(
    start: ZhangStart, model: LensModel, images: LensImages
) -> tuple[LensFit, LensImages]:
    """The fit without the circles that no lens of the model explains, and the circles kept.

    The influence of wrong circles is bounded ever more tightly, then those beyond what noise
    makes are left out.
    """
    fit = fit_model(start, model, images)
    if not is_suspect(_all_whitened(fit, images)):
        return fit, images
    for factor in ANNEALING:
        scale = factor * robust_scale(_all_whitened(fit, images))
        fit = fit_model(reached(fit), model, images, scale)
    right = inliers(_all_whitened(fit, images))
    ends = np.cumsum([len(detection) for detection in images.detections])[:-1]
    images = images._replace(used=np.split(right, ends))
    return fit_model(reached(fit), model, images), images


def reached(fit: LensFit) -> ZhangStart:
    """Where a fit ended, to start the next from."""
    return ZhangStart(fit.lens, np.asarray(fit.cam_from_world))


def _all_whitened(fit: LensFit, images: LensImages) -> Float[np.ndarray, "m 2"]:
    """Whitened errors of the circles of all pictures, one after the other."""
    return np.concatenate(
        [
            errors[: len(detection)]
            for errors, detection in zip(fit.whitened, images.detections, strict=True)
        ]
    )
