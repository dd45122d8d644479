"""The dark that a crossed line's blur throws on the edge of a circle beside it."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detection.ellipse_fit import Ellipses
from trinoc.calib.detection.ellipse_pixels import EllipsePixels
from trinoc.calib.detection.normal_table import normal_cdf
from trinoc.calib.detection.plane_mapping import PlaneMapping
from trinoc.calib.targets import Pattern

# Blurs beyond which a line's dark is not felt.
_REACH = 3.0


def without_line_interference(
    pixels: EllipsePixels,
    fitted: Ellipses,
    index: Int[np.ndarray, "n"],
    pattern: Pattern,
    warp: PlaneMapping,
    outer: Float[np.ndarray, "n"],
) -> EllipsePixels:
    """`pixels` as they would be without the lines that pass beside the circles.

    outer : how many radii of each ellipse the pixels reach out. Lines that meet a circle are
        left to the fit, which takes their pixels for outliers.
    """
    if pattern.line_width_mm == 0.0:
        return pixels
    grey = pixels.grey
    for axis in (0, 1):
        grey = _without_line(pixels, grey, fitted, index, pattern, warp, outer, axis)
    return pixels._replace(grey=grey)


def _without_line(
    pixels: EllipsePixels,
    grey: Float[np.ndarray, "n p"],
    fitted: Ellipses,
    index: Int[np.ndarray, "n"],
    pattern: Pattern,
    warp: PlaneMapping,
    outer: Float[np.ndarray, "n"],
    axis: int,
) -> Float[np.ndarray, "n p"]:
    centre_mm = pattern.centres_mm[index]
    half_mm = pattern.line_half_length_mm[axis]
    foot_mm = np.zeros_like(centre_mm)
    foot_mm[:, axis] = centre_mm[:, axis]
    along_mm, across_mm = np.zeros(2), np.zeros(2)
    along_mm[axis] = across_mm[1 - axis] = 0.5 * pattern.line_width_mm
    foot = warp.apply(foot_mm)
    direction = warp.apply(foot_mm + along_mm) - foot
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    normal /= np.maximum(np.sqrt(np.sum(normal**2, axis=1, keepdims=True)), 1e-12)
    half_width = np.abs(np.sum((warp.apply(foot_mm + across_mm) - foot) * normal, axis=1))
    apart = np.abs(np.sum((fitted.centres_px - foot) * normal, axis=1))
    extent = outer * np.sqrt(np.einsum("ni,nij,nj->n", normal, fitted.shape_px2, normal))
    met_mm = pattern.radius_mm[index] + pattern.line_gap_mm + pattern.line_width_mm
    shaded = (
        (apart - extent < half_width + _REACH * fitted.blur_px)
        & (np.abs(centre_mm[:, 1 - axis]) > met_mm)
        & (np.abs(centre_mm[:, axis]) < half_mm)
    )
    if not np.any(shaded):
        return grey
    local = foot - pixels.origin_px
    inverse_blur = (1.0 / fitted.blur_px).astype(np.float32)

    def column(values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 1"]:
        return values.astype(np.float32)[:, None]

    distance = column(normal[:, 0]) * (pixels.x - column(local[:, 0]))
    distance += column(normal[:, 1]) * (pixels.y - column(local[:, 1]))
    wide = column(half_width)
    coverage = normal_cdf((distance + wide) * inverse_blur[:, None])
    coverage -= normal_cdf((distance - wide) * inverse_blur[:, None])
    return grey + column(np.where(shaded, fitted.paper * fitted.ink, 0.0)) * coverage
