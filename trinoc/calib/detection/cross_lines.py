"""Last step of the detection of a sheet: the two crossed lines.

The circles predict the position of the lines. This file also removes the blur of a line from the
edges of neighbouring circles.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.detection.ellipse_fit import Ellipses
from trinoc.calib.detection.ellipse_pixels import (
    EllipsePixels,
    column_32,
    normal_cdf,
    quick_median,
)
from trinoc.calib.detection.plane_mapping import PlaneMapping
from trinoc.calib.detection.search_image import SearchImage
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import CalibTuning

# numerical: number of cross sections per line.
_STATIONS = 96
# numerical: iterations; the fit has converged after these.
_REWEIGHTINGS = 3
# numerical: at this distance from a line, in blurs, its darkening is below .2 %.
_REACH_BLURS = 3.0


def fit_cross_lines(
    image: SearchImage,
    pattern: Pattern,
    mapping: PlaneMapping,
    blur_px: float,
    tuning: CalibTuning,
) -> Float[np.ndarray, "2 3"]:
    """Measure the images of the sheet's lines along X and along Y.

    Grey profiles are sampled across the predicted line at many stations, away from the circles and
    the other line. The centroid of the darkness of a profile is a point of the line.

    Parameters
    ----------
    image : grey image with its noise.
    pattern : the sheet.
    mapping : mapping from the sheet, mm, to the image, px.
    blur_px : sigma of the image's blur.
    tuning : tuned constants of calibration.

    Returns
    -------
    (2, 3) homogeneous lines with unit normals, px; NaN for a line that is not visible.
    """
    lines = np.full((2, 3), np.nan)
    if pattern.line_width_mm == 0.0:
        return lines
    for axis in (0, 1):
        stations = _stations_mm(pattern, axis)
        if len(stations) >= tuning.detection.fewest_stations:
            lines[axis] = _fit_line(image, stations, axis, pattern, mapping, blur_px, tuning)
    return lines


def _stations_mm(pattern: Pattern, axis: int) -> Float[np.ndarray, "n 2"]:
    """Points (X, Y) of the sheet's line along `axis`, away from the circles and the other line."""
    half = pattern.line_half_length_mm[axis]
    along = np.linspace(-half, half, _STATIONS + 2)[1:-1]
    stations = np.zeros((_STATIONS, 2))
    stations[:, axis] = along
    margin_mm = pattern.line_gap_mm + pattern.line_width_mm
    reach_mm = pattern.radius_mm + margin_mm
    # Only circles near the line matter.
    is_near = np.abs(pattern.centres_mm[:, 1 - axis]) < reach_mm
    free = np.abs(along) > 3 * pattern.line_width_mm
    if np.any(is_near):
        distance = np.linalg.norm(stations[:, None] - pattern.centres_mm[is_near], axis=2)
        free &= np.all(distance > reach_mm[is_near], axis=1)
    return stations[free]


def _fit_line(
    image: SearchImage,
    stations_mm: Float[np.ndarray, "n 2"],
    axis: int,
    pattern: Pattern,
    mapping: PlaneMapping,
    blur_px: float,
    tuning: CalibTuning,
) -> Float[np.ndarray, "3"]:
    side = np.zeros(2)
    side[1 - axis] = 0.5 * pattern.line_width_mm
    stations = mapping.apply(stations_mm)
    half_width_px = np.linalg.norm(mapping.apply(stations_mm + side) - stations, axis=1)
    along = np.gradient(stations, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    reach = quick_median(half_width_px) + 2.5 * max(blur_px, 0.5) + 1.0
    inside = (stations > reach + 1) & (stations < np.array(image.size_px) - reach - 2)
    inside = np.all(inside, axis=1)
    stations, normal = stations[inside], normal[inside]
    if len(stations) < tuning.detection.fewest_stations:
        return np.full(3, np.nan)
    steps = np.linspace(-2 * reach, 2 * reach, 2 * int(np.ceil(4 * reach)) + 1)
    samples = (stations[:, None] + steps[None, :, None] * normal[:, None]).astype(np.float32)
    profile = cv2.remap(image.grey, samples[..., 0], samples[..., 1], cv2.INTER_LINEAR)
    core = np.abs(steps) <= reach
    paper = 0.5 * (
        quick_median(profile[:, steps < -reach]) + quick_median(profile[:, steps > reach])
    )
    dark = (paper[:, None] - profile) * core
    mass = dark.sum(axis=1)
    mean_noise = max(image.noise_sigma, 1e-6) * np.sqrt(core.sum())
    is_visible = mass > max(4.0 * mean_noise, 0.35 * float(quick_median(mass)))
    if np.sum(is_visible) < max(tuning.detection.fewest_stations, 0.3 * len(mass)):
        return np.full(3, np.nan)
    offset = (dark[is_visible] @ steps) / mass[is_visible]
    points = stations[is_visible] + offset[:, None] * normal[is_visible]
    return _robust_line(points)


def _robust_line(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3"]:
    """Homogeneous line with unit normal through points.

    It is fitted by total least squares with Cauchy weights.
    """
    weight = np.ones(len(points))
    line = np.full(3, np.nan)
    for _ in range(_REWEIGHTINGS):
        mean = weight @ points / weight.sum()
        relative = points - mean
        _, vectors = np.linalg.eigh((relative * weight[:, None]).T @ relative)
        normal = vectors[:, 0]
        distance = relative @ normal
        scale = 2.0 * quick_median(np.abs(distance)) + 1e-3
        weight = 1.0 / (1.0 + (distance / scale) ** 2)
        line = np.append(normal, -(normal @ mean))
    return line


def are_clear_of_lines(
    pattern: Pattern, index: Int[np.ndarray, "n"], tuning: CalibTuning
) -> Bool[np.ndarray, "n"]:
    """Mask of the circles that are far enough from the crossed lines, (n,).

    The grey level of the paper can be read around these circles.

    Parameters
    ----------
    pattern : the sheet.
    index : (n,) pattern indices of the circles.
    tuning : tuned constants of calibration.
    """
    centre_mm = np.abs(pattern.centres_mm[index])
    reach_mm = tuning.detection.outer_radii * pattern.radius_mm[index, None]
    is_near = centre_mm[:, ::-1] < reach_mm + 0.5 * pattern.line_width_mm
    is_within_ends = centre_mm < reach_mm + np.array(pattern.line_half_length_mm)
    return ~np.any(is_near & is_within_ends, axis=1) | (pattern.line_width_mm == 0.0)


def subtract_line_blur(
    pixels: EllipsePixels,
    fitted: Ellipses,
    index: Int[np.ndarray, "n"],
    pattern: Pattern,
    mapping: PlaneMapping,
    outer: Float[np.ndarray, "n"],
) -> EllipsePixels:
    """Remove the darkening by a blurred crossed line from the pixels around circles.

    Lines that meet a circle are not removed, because the fit excludes their pixels as outliers.

    Parameters
    ----------
    pixels : pixels around the circles.
    fitted : (n,) current ellipses of the circles.
    index : (n,) pattern index of each circle.
    pattern : the sheet.
    mapping : mapping from the sheet, mm, to the image, px.
    outer : (n,) outer limit of the pixels of each circle, in radii of its ellipse.
    """
    if pattern.line_width_mm == 0.0:
        return pixels
    grey = pixels.grey
    centre_mm = pattern.centres_mm[index]
    contact_mm = pattern.radius_mm[index] + pattern.line_gap_mm + pattern.line_width_mm
    inverse_blur = column_32(1.0 / fitted.blur_px)
    for axis in (0, 1):
        foot_mm = np.zeros_like(centre_mm)
        foot_mm[:, axis] = centre_mm[:, axis]
        along_mm, across_mm = np.zeros(2), np.zeros(2)
        along_mm[axis] = across_mm[1 - axis] = 0.5 * pattern.line_width_mm
        foot = mapping.apply(foot_mm)
        direction = mapping.apply(foot_mm + along_mm) - foot
        normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        normal /= np.maximum(np.sqrt(np.sum(normal**2, axis=1, keepdims=True)), 1e-12)
        half_width = np.abs(np.sum((mapping.apply(foot_mm + across_mm) - foot) * normal, axis=1))
        distance_px = np.abs(np.sum((fitted.centres_px - foot) * normal, axis=1))
        extent = outer * np.sqrt(np.einsum("ni,nij,nj->n", normal, fitted.shape_px2, normal))
        shaded = (
            (distance_px - extent < half_width + _REACH_BLURS * fitted.blur_px)
            & (np.abs(centre_mm[:, 1 - axis]) > contact_mm)
            & (np.abs(centre_mm[:, axis]) < pattern.line_half_length_mm[axis])
        )
        if not np.any(shaded):
            continue
        local = foot - pixels.origin_px
        distance = column_32(normal[:, 0]) * (pixels.x - column_32(local[:, 0]))
        distance += column_32(normal[:, 1]) * (pixels.y - column_32(local[:, 1]))
        half_width_32 = column_32(half_width)
        coverage = normal_cdf((distance + half_width_32) * inverse_blur)
        coverage -= normal_cdf((distance - half_width_32) * inverse_blur)
        grey = grey + column_32(np.where(shaded, fitted.paper * fitted.ink, 0.0)) * coverage
    return pixels._replace(grey=grey)
