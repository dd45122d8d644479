"""Rays beside a right circular cylinder: each ray of an outline touches it.

A ray from the centre of projection C along u passes an axis through p along the unit vector d at
the signed distance c . (p - C), with c the unit vector of d x u. The sign says on which side of the
axis it passes, for all cameras alike. A ray touches where the distance is the radius, so that the
two ends of a segment of an outline give two equations, linear in the radius.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.numerics import axes_across, cross_3d


class Rays(NamedTuple):
    """Viewing rays of both ends of segments.

    centre_mm : of projection. ray : of each end, of any length, forward. slope : change of the
    ray where its end moves by one pixel across the segment, along the segment's normal.
    """

    centre_mm: Float[np.ndarray, "*n 3"]
    ray: Float[np.ndarray, "*n 2 3"]
    slope: Float[np.ndarray, "*n 2 3"]


class Passing(NamedTuple):
    """How rays pass an axis, for both ends of each segment.

    distance_mm : with its sign. per_px : its change by a pixel across the segment. by_axis : its
    change by an offset of the axis, mm, and by a tilt about its point, rad, in its two axes across.
    """

    distance_mm: Float[np.ndarray, "*n 2"]
    per_px: Float[np.ndarray, "*n 2"]
    by_axis: Float[np.ndarray, "*n 2 4"]


def passing(
    rays: Rays, point_mm: Float[np.ndarray, "... 3"], direction: Float[np.ndarray, "... 3"]
) -> Passing:
    """Signed distances of rays from an axis, and their derivatives; leading axes are broadcast."""
    d, w = direction[..., None, :], (point_mm - rays.centre_mm)[..., None, :]
    normal = cross_3d(d, rays.ray)
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    size = np.maximum(size, np.finfo(float).tiny)
    unit = normal / size
    distance = (unit * w).sum(axis=-1)
    rest = (w - distance[..., None] * unit) / size
    per_px = (rest * cross_3d(d, rays.slope)).sum(axis=-1)
    # A segment across the axis moves along its outline alone: it is infinitely far off.
    per_px = np.where(per_px == 0.0, np.maximum(1e-12 * np.abs(distance), 1e-12), per_px)
    across = axes_across(direction)[..., None, :, :]
    offset = (unit[..., None, :] * across).sum(axis=-1)
    tilt = (rest[..., None, :] * cross_3d(across, rays.ray[..., None, :])).sum(axis=-1)
    return Passing(distance, per_px, np.concatenate([offset, tilt], axis=-1))


def abreast_mm(
    rays: Rays, point_mm: Float[np.ndarray, "... 3"], direction: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "... 2"]:
    """Where along the axis, from its point, each ray is nearest to it."""
    u, d, w = rays.ray, direction[..., None, :], (point_mm - rays.centre_mm)[..., None, :]
    square, along = (u**2).sum(axis=-1), (u * d).sum(axis=-1)
    toward, before = (u * w).sum(axis=-1), (w * d).sum(axis=-1)
    return (along * toward - square * before) / (square - along**2)


def before_camera(rays: Rays, point_mm: Float[np.ndarray, "... 3"]) -> Bool[np.ndarray, "..."]:
    """Whether a point lies before the camera, by each segment's rays."""
    return (rays.ray.sum(axis=-2) * (point_mm - rays.centre_mm)).sum(axis=-1) > 0
