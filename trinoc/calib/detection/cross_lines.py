"""The two crossed lines: found where the circles say they are, and taken off the circles' edges."""

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

# numerical: size of a sample.
_STATIONS = 96
# numerical: of an iteration that converges.
_REWEIGHTINGS = 3
# numerical: a line's dark is below .2 % of its own so many blurs beside it.
_REACH_BLURS = 3.0


def fit_cross_lines(
    image: SearchImage,
    pattern: Pattern,
    mapping: PlaneMapping,
    blur_px: float,
    tuning: CalibTuning,
) -> Float[np.ndarray, "2 3"]:
    """Images of the lines along X and along Y, unit normals; NaN where not seen.

    Each line's grey profile is taken across its predicted place at many stations, away from
    the circles and the other line; the weighted mean of the dark there is the line's middle.
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
    half = pattern.line_half_length_mm[axis]
    along = np.linspace(-half, half, _STATIONS + 2)[1:-1]
    stations = np.zeros((_STATIONS, 2))
    stations[:, axis] = along
    margin_mm = pattern.line_gap_mm + pattern.line_width_mm
    reach_mm = pattern.radius_mm + margin_mm
    # Of the circles only those that the line passes matter.
    beside = np.abs(pattern.centres_mm[:, 1 - axis]) < reach_mm
    free = np.abs(along) > 3 * pattern.line_width_mm
    if np.any(beside):
        clear = np.linalg.norm(stations[:, None] - pattern.centres_mm[beside], axis=2)
        free &= np.all(clear > reach_mm[beside], axis=1)
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
    place = mapping.apply(stations_mm)
    half_width_px = np.linalg.norm(mapping.apply(stations_mm + side) - place, axis=1)
    along = np.gradient(place, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    reach = quick_median(half_width_px) + 2.5 * max(blur_px, 0.5) + 1.0
    inside = np.all((place > reach + 1) & (place < np.array(image.size_px) - reach - 2), axis=1)
    place, normal = place[inside], normal[inside]
    if len(place) < tuning.detection.fewest_stations:
        return np.full(3, np.nan)
    steps = np.linspace(-2 * reach, 2 * reach, 2 * int(np.ceil(4 * reach)) + 1)
    at = (place[:, None] + steps[None, :, None] * normal[:, None]).astype(np.float32)
    profile = cv2.remap(image.grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    core = np.abs(steps) <= reach
    paper = 0.5 * (
        quick_median(profile[:, steps < -reach]) + quick_median(profile[:, steps > reach])
    )
    dark = (paper[:, None] - profile) * core
    mass = dark.sum(axis=1)
    mean_noise = max(image.noise_sigma, 1e-6) * np.sqrt(core.sum())
    seen = mass > max(4.0 * mean_noise, 0.35 * float(quick_median(mass)))
    if np.sum(seen) < max(tuning.detection.fewest_stations, 0.3 * len(mass)):
        return np.full(3, np.nan)
    offset = (dark[seen] @ steps) / mass[seen]
    points = place[seen] + offset[:, None] * normal[seen]
    return _robust_line(points)


def _robust_line(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3"]:
    """Total least squares with Cauchy weights; NaN when the points do not agree on a line."""
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
    """Whether no line darkens the paper beside each circle, where its grey is read."""
    centre_mm = np.abs(pattern.centres_mm[index])
    reach_mm = tuning.detection.outer_radii * pattern.radius_mm[index, None]
    beside = centre_mm[:, ::-1] < reach_mm + 0.5 * pattern.line_width_mm
    along = centre_mm < reach_mm + np.array(pattern.line_half_length_mm)
    return ~np.any(beside & along, axis=1) | (pattern.line_width_mm == 0.0)


def subtract_line_blur(
    pixels: EllipsePixels,
    fitted: Ellipses,
    index: Int[np.ndarray, "n"],
    pattern: Pattern,
    mapping: PlaneMapping,
    outer: Float[np.ndarray, "n"],
) -> EllipsePixels:
    """`pixels` without the dark that the blur of a line throws on the edge of a circle beside it.

    outer : how many radii of each ellipse the pixels reach out. Lines that meet a circle are
        left to the fit, which takes their pixels for outliers.
    """
    if pattern.line_width_mm == 0.0:
        return pixels
    grey = pixels.grey
    centre_mm = pattern.centres_mm[index]
    met_mm = pattern.radius_mm[index] + pattern.line_gap_mm + pattern.line_width_mm
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
        apart = np.abs(np.sum((fitted.centres_px - foot) * normal, axis=1))
        extent = outer * np.sqrt(np.einsum("ni,nij,nj->n", normal, fitted.shape_px2, normal))
        shaded = (
            (apart - extent < half_width + _REACH_BLURS * fitted.blur_px)
            & (np.abs(centre_mm[:, 1 - axis]) > met_mm)
            & (np.abs(centre_mm[:, axis]) < pattern.line_half_length_mm[axis])
        )
        if not np.any(shaded):
            continue
        local = foot - pixels.origin_px
        distance = column_32(normal[:, 0]) * (pixels.x - column_32(local[:, 0]))
        distance += column_32(normal[:, 1]) * (pixels.y - column_32(local[:, 1]))
        wide = column_32(half_width)
        coverage = normal_cdf((distance + wide) * inverse_blur)
        coverage -= normal_cdf((distance - wide) * inverse_blur)
        grey = grey + column_32(np.where(shaded, fitted.paper * fitted.ink, 0.0)) * coverage
    return pixels._replace(grey=grey)
