"""The two crossed lines, found where the circles say they are."""

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.plane_mapping import PlaneMapping
from trinoc.calib.detection.quick_median import quick_median
from trinoc.calib.targets import Pattern

_STATIONS = 96
_FEWEST_STATIONS = 10
_REWEIGHTINGS = 3


def fit_cross_lines(
    grey: Float[np.ndarray, "h w"],
    noise_sigma: float,
    pattern: Pattern,
    warp: PlaneMapping,
    blur_px: float,
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
        if len(stations) >= _FEWEST_STATIONS:
            lines[axis] = _fit_line(grey, noise_sigma, stations, axis, pattern, warp, blur_px)
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
    grey: Float[np.ndarray, "h w"],
    noise_sigma: float,
    stations_mm: Float[np.ndarray, "n 2"],
    axis: int,
    pattern: Pattern,
    warp: PlaneMapping,
    blur_px: float,
) -> Float[np.ndarray, "3"]:
    side = np.zeros(2)
    side[1 - axis] = 0.5 * pattern.line_width_mm
    place = warp.apply(stations_mm)
    half_width_px = np.linalg.norm(warp.apply(stations_mm + side) - place, axis=1)
    along = np.gradient(place, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    height, width = grey.shape
    reach = quick_median(half_width_px) + 2.5 * max(blur_px, 0.5) + 1.0
    inside = np.all((place > reach + 1) & (place < np.array([width, height]) - reach - 2), axis=1)
    place, normal = place[inside], normal[inside]
    if len(place) < _FEWEST_STATIONS:
        return np.full(3, np.nan)
    steps = np.linspace(-2 * reach, 2 * reach, 2 * int(np.ceil(4 * reach)) + 1)
    at = (place[:, None] + steps[None, :, None] * normal[:, None]).astype(np.float32)
    profile = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    core = np.abs(steps) <= reach
    paper = 0.5 * (
        quick_median(profile[:, steps < -reach]) + quick_median(profile[:, steps > reach])
    )
    dark = (paper[:, None] - profile) * core
    mass = dark.sum(axis=1)
    mean_noise = max(noise_sigma, 1e-6) * np.sqrt(core.sum())
    seen = mass > max(4.0 * mean_noise, 0.35 * float(quick_median(mass)))
    if np.sum(seen) < max(_FEWEST_STATIONS, 0.3 * len(mass)):
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
