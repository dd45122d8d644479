"""What may be outlines of round bodies, and how their rays pass the axis of one.

A ray from the centre of projection C along u passes an axis through p along the unit vector d at
the signed distance c . (p - C), with c the unit vector of d x u. The sign says on which side of the
axis it passes, for all cameras alike. A ray touches where the distance is the radius, so that the
two ends of a segment of an outline give two equations, linear in the radius.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.observations.match_input import MatchInput
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.bodies import CylinderTuning
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.vectors import complete_axes, cross_3d


class Rays(NamedTuple):
    """Viewing rays of both ends of segments.

    centre_mm : of projection. ray : of each end, of any length, forward. slope : change of the
    ray where its end moves by one pixel across the segment, along the segment's normal.
    """

    centre_mm: Float[np.ndarray, "*n 3"]
    ray: Float[np.ndarray, "*n 2 3"]
    slope: Float[np.ndarray, "*n 2 3"]


class RayAxisDistances(NamedTuple):
    """How rays pass an axis, for both ends of each segment.

    distance_mm : with its sign. per_px : its change by a pixel across the segment. by_axis : its
    change by an offset of the axis, mm, and by a tilt about its point, rad, in its two axes across.
    """

    distance_mm: Float[np.ndarray, "*n 2"]
    per_px: Float[np.ndarray, "*n 2"]
    by_axis: Float[np.ndarray, "*n 2 4"]


def ray_axis_distances(
    rays: Rays, point_mm: Float[np.ndarray, "... 3"], direction: Float[np.ndarray, "... 3"]
) -> RayAxisDistances:
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
    across = complete_axes(direction)[..., None, :, :]
    offset = (unit[..., None, :] * across).sum(axis=-1)
    tilt = (rest[..., None, :] * cross_3d(across, rays.ray[..., None, :])).sum(axis=-1)
    return RayAxisDistances(distance, per_px, np.concatenate([offset, tilt], axis=-1))


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


class Outlines(NamedTuple):
    """Segments of all views in one table, the longest first.

    view : in the order of the matches. segment : the caller's number. ends_px : undistorted.
    length_px : of each. across_px2 : covariance of both ends' errors across, those of an outline
    that ends in a rim included. rays : of its ends. density : segments of its direction per pixel
    across and per radian in its picture. size_px : of that picture, the mean of its sides.
    """

    view: Int[np.ndarray, "n"]
    segment: Int[np.ndarray, "n"]
    ends_px: Float[np.ndarray, "n 2 2"]
    length_px: Float[np.ndarray, "n"]
    across_px2: Float[np.ndarray, "n 2 2"]
    rays: Rays
    density: Float[np.ndarray, "n"]
    size_px: Float[np.ndarray, "n"]

    @property
    def normals(self) -> Float[np.ndarray, "*n 3"]:
        """Unit normals of the planes through each segment and its centre of projection."""
        normal = cross_3d(self.rays.ray[..., 0, :], self.rays.ray[..., 1, :])
        return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def possible_outlines(seen: MatchInput, matches: Matches, tuning: CylinderTuning) -> Outlines:
    """All segments but those of tracks in three views that agree about their place."""
    agreed = (matches.index >= 0).sum(axis=1) > 2
    agreed &= np.asarray(matches.posterior) > tuning.certain_posterior
    if matches.viewpoint_dependent is not None:
        agreed &= ~matches.viewpoint_dependent
    parts = []
    for number, name in enumerate(matches.views):
        view = seen.names.index(name)
        order, ends = seen.order[view], seen.ends_px[view]
        free = np.ones(len(order), dtype=bool)
        placed = matches.index[agreed, number]
        free[np.isin(order, placed[placed >= 0])] = False
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        rows = np.flatnonzero(free & (length >= tuning.shortest_px))
        parts.append(_of_view(seen, view, number, rows, tuning))
    table = concatenate_rows(parts)
    return take_rows(table, np.argsort(-table.length_px, kind="stable"))


def _of_view(
    seen: MatchInput, view: int, number: int, rows: Int[np.ndarray, "k"], tuning: CylinderTuning
) -> Outlines:
    every = seen.ends_px[view]
    ends = every[rows]
    line = np.asarray(seen.lines.line)[view, rows]
    across = np.asarray(seen.lines.across_px2)[view, rows] + tuning.rim_px**2 * np.eye(2)
    normal = np.concatenate([line[:, :2], np.zeros((len(rows), 1))], axis=1)
    slope = normal @ np.asarray(seen.lines.inverse)[view].T
    rays = Rays(
        np.broadcast_to(np.asarray(seen.lines.centre_mm)[view], (len(rows), 3)),
        np.asarray(seen.lines.rays)[view, rows],
        np.repeat(slope[:, None], 2, axis=1),
    )
    size = float(np.sqrt(np.prod(np.asarray(seen.lines.size_px)[view])))
    near = _acute_deg(_angle_deg(ends)[:, None] - _angle_deg(ends)) < tuning.parallel_deg
    density = near.sum(axis=1) / (size * np.radians(2 * tuning.parallel_deg))
    return Outlines(
        np.full(len(rows), number),
        seen.order[view][rows],
        ends,
        np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1),
        across,
        rays,
        density,
        np.full(len(rows), size),
    )


def _angle_deg(ends_px: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    way = ends_px[:, 1] - ends_px[:, 0]
    return np.degrees(np.arctan2(way[:, 1], way[:, 0]))


def _acute_deg(turn_deg: np.ndarray) -> np.ndarray:
    return np.abs((turn_deg + 90.0) % 180.0 - 90.0)
