"""Corners: places in space where ends of matched lines meet, and ends that meet nothing."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.match.guided.state import State
from trinoc.match.tuning import GuidedTuning
from trinoc.numerics import group_labels


class Ends(NamedTuple):
    """All ends of all tracks, 2 t of them: track k's are 2 k and 2 k + 1.

    place_mm : (n, 3). corner : (n,) which corner each belongs to. met : (n,) whether another line,
    of another direction, ends there too.
    """

    place_mm: Float[np.ndarray, "n 3"]
    corner: Int[np.ndarray, "n"]
    met: Bool[np.ndarray, "n"]


class Corners(NamedTuple):
    """place_mm : (c, 3), covariance_mm2 : (c, 3, 3)."""

    place_mm: Float[np.ndarray, "c 3"]
    covariance_mm2: Float[np.ndarray, "c 3 3"]


def mm_per_px(state: State, places_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """The least size of a pixel at these places, of all views."""
    matrix = state.cameras.matrix_px
    depth = places_mm @ matrix[:, 2, :3].T + matrix[:, 2, 3]
    focal = np.linalg.norm(matrix[:, 0, :3], axis=1) / np.linalg.norm(matrix[:, 2, :3], axis=1)
    length = np.linalg.norm(matrix[:, 2, :3], axis=1)
    return np.abs(depth / (length * focal)).min(axis=1)


def ends_of(state: State, tuning: GuidedTuning) -> Ends:
    """Which ends of lines meet."""
    lines = state.tracks.ends_mm
    places = lines.reshape(-1, 3)
    if len(places) == 0:
        return Ends(places, np.zeros(0, np.int64), np.zeros(0, bool))
    unit = np.repeat(_units(lines), 2, axis=0)
    near = tuning.meet_px * mm_per_px(state, places)
    one, other = KDTree(places).query_pairs(float(near.max()), output_type="ndarray").T
    apart = np.linalg.norm(places[one] - places[other], axis=1)
    close = (apart < np.minimum(near[one], near[other])) & (one // 2 != other // 2)
    one, other = one[close], other[close]
    turned = np.abs((unit[one] * unit[other]).sum(axis=1)) < np.cos(np.radians(tuning.meet_deg))
    met = np.zeros(len(places), dtype=bool)
    met[one[turned]] = met[other[turned]] = True
    label = group_labels(len(places), one[turned], other[turned])
    return Ends(places, np.unique(label, return_inverse=True)[1], met)


def corners_of(state: State, ends: Ends, tuning: GuidedTuning) -> Corners:
    """The place nearest to all lines that end in each corner, as near as each is known."""
    lines = state.tracks.ends_mm
    unit = np.repeat(_units(lines), 2, axis=0)
    blocks = state.tracks.covariance_mm2.reshape(-1, 2, 3, 2, 3)
    own = np.stack([blocks[:, 0, :, 0, :], blocks[:, 1, :, 1, :]], axis=1).reshape(-1, 3, 3)
    size = mm_per_px(state, ends.place_mm)
    along = np.where(ends.met, 1e3, tuning.free_end_px) * size
    own = own + (along**2)[:, None, None] * unit[:, :, None] * unit[:, None, :]
    own = own + ((tuning.corner_floor_px * size) ** 2)[:, None, None] * np.eye(3)
    information = np.linalg.inv(own)
    count = int(ends.corner.max()) + 1 if len(ends.corner) else 0
    total, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(total, ends.corner, information)
    np.add.at(right, ends.corner, (information @ ends.place_mm[:, :, None])[..., 0])
    covariance = np.linalg.inv(total)
    return Corners((covariance @ right[:, :, None])[..., 0], covariance)


def _units(lines_mm: Float[np.ndarray, "t 2 3"]) -> Float[np.ndarray, "t 3"]:
    way = lines_mm[:, 1] - lines_mm[:, 0]
    return way / np.linalg.norm(way, axis=1)[:, None]
