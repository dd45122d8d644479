"""What may be the outline of a round body: segments that three views do not place in space."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.cylinders.tangency import Rays
from trinoc.match.observations import MatchInput
from trinoc.match.tracks import Matches
from trinoc.match.tuning import CylinderTuning
from trinoc.numerics import cross_3d


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

    def take(self, rows: np.ndarray) -> "Outlines":
        """Some of them, in any shape."""
        return Outlines(
            self.view[rows],
            self.segment[rows],
            self.ends_px[rows],
            self.length_px[rows],
            self.across_px2[rows],
            Rays(self.rays.centre_mm[rows], self.rays.ray[rows], self.rays.slope[rows]),
            self.density[rows],
            self.size_px[rows],
        )


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
    table = Outlines(
        np.concatenate([part.view for part in parts]),
        np.concatenate([part.segment for part in parts]),
        np.concatenate([part.ends_px for part in parts]),
        np.concatenate([part.length_px for part in parts]),
        np.concatenate([part.across_px2 for part in parts]),
        Rays(*map(np.concatenate, zip(*(part.rays for part in parts), strict=True))),
        np.concatenate([part.density for part in parts]),
        np.concatenate([part.size_px for part in parts]),
    )
    return table.take(np.argsort(-table.length_px, kind="stable"))


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
    near = _undirected_deg(_angle_deg(ends)[:, None] - _angle_deg(ends)) < tuning.parallel_deg
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


def _undirected_deg(turn_deg: np.ndarray) -> np.ndarray:
    return np.abs((turn_deg + 90.0) % 180.0 - 90.0)
