"""The light on the sheet, smooth from circle to circle."""

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.quick_median import quick_median

_PLANE_CIRCLES = 6
_QUADRATIC_CIRCLES = 12
_REWEIGHTINGS = 3
# A circle and those round it.
_NEIGHBOURS = 5
# Relative change per pixel that light may have where too few circles tell.
_UNKNOWN_SLOPE = 0.005


def light_slope(
    centres_px: Float[np.ndarray, "n 2"], paper: Float[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Relative change of the paper's grey per pixel at each circle, and how sure it is.

    A quadratic through the greys round all circles says more of the slope across one circle
    than its own pixels do, and costs its centre nothing. Where the greys do not lie on that
    surface, near a shadow, the slope is as unsure as they are over one pitch.
    """
    count = len(paper)
    if count < _PLANE_CIRCLES:
        return np.zeros((count, 2)), np.full(count, _UNKNOWN_SLOPE)
    middle = centres_px.mean(axis=0)
    extent = max(float(np.abs(centres_px - middle).max()), 1.0)
    x, y = ((centres_px - middle) / extent).T
    one, zero = np.ones(count), np.zeros(count)
    terms = [one, x, y]
    terms_x, terms_y = [zero, one, zero], [zero, zero, one]
    if count >= _QUADRATIC_CIRCLES:
        terms += [x * x, x * y, y * y]
        terms_x += [2 * x, y, zero]
        terms_y += [zero, x, 2 * y]
    basis = np.stack(terms, axis=1)
    weight = one
    for _ in range(_REWEIGHTINGS):
        weighted = basis * weight[:, None]
        surface, *_ = np.linalg.lstsq(weighted, paper * weight, rcond=None)
        miss = np.abs(paper - basis @ surface)
        scale = 3.0 * quick_median(miss) + 1e-9 * np.abs(paper).max() + 1e-30
        weight = 1.0 / (1.0 + (miss / scale) ** 2)
    light = basis @ surface
    light = np.where(np.abs(light) > 1e-9, light, 1e-9)
    slope = np.stack([np.stack(terms_x, 1) @ surface, np.stack(terms_y, 1) @ surface], axis=1)
    distance = np.linalg.norm(centres_px[:, None] - centres_px[None], axis=2)
    nearest = np.argsort(distance, axis=1)[:, :_NEIGHBOURS]
    pitch_px = quick_median(distance[np.arange(count), nearest[:, 1]])
    relative_miss = (paper - basis @ surface) / light
    unsure = np.sqrt(np.mean(relative_miss[nearest] ** 2, axis=1)) / pitch_px
    return slope / extent / light[:, None], unsure
