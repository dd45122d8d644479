"""Lines that may be there: from a corner, parallel to a line near it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.match.pixels.state import State
from trinoc.match.tuning.guided import GuidedTuning
from trinoc.numerics.joins import group_labels


class JoinedEnds(NamedTuple):
    """All ends of all tracks, 2 t of them: track k's are 2 k and 2 k + 1.

    place_mm : (n, 3). corner : (n,) which corner each belongs to. met : (n,) whether another line,
    of another direction, ends there too.
    """

    place_mm: Float[np.ndarray, "n 3"]
    corner: Int[np.ndarray, "n"]
    met: Bool[np.ndarray, "n"]


class LocatedCorners(NamedTuple):
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


def joined_ends(state: State, tuning: GuidedTuning) -> JoinedEnds:
    """Which ends of lines meet."""
    lines = state.tracks.ends_mm
    places = lines.reshape(-1, 3)
    if len(places) == 0:
        return JoinedEnds(places, np.zeros(0, np.int64), np.zeros(0, bool))
    unit = np.repeat(_units(lines), 2, axis=0)
    near = tuning.meet_px * mm_per_px(state, places)
    one, other = KDTree(places).query_pairs(float(near.max()), output_type="ndarray").T
    apart = np.linalg.norm(places[one] - places[other], axis=1)
    close = (apart < np.minimum(near[one], near[other])) & (one // 2 != other // 2)
    one, other = one[close], other[close]
    turned = np.abs((unit[one] * unit[other]).sum(axis=1)) < np.cos(
        np.radians(tuning.same_direction_deg)
    )
    met = np.zeros(len(places), dtype=bool)
    met[one[turned]] = met[other[turned]] = True
    label = group_labels(len(places), one[turned], other[turned])
    return JoinedEnds(places, np.unique(label, return_inverse=True)[1], met)


def locate_corners(state: State, ends: JoinedEnds, tuning: GuidedTuning) -> LocatedCorners:
    """The place nearest to all lines that end in each corner, as near as each is known."""
    lines = state.tracks.ends_mm
    unit = np.repeat(_units(lines), 2, axis=0)
    blocks = state.tracks.covariance_mm2.reshape(-1, 2, 3, 2, 3)
    own = np.stack([blocks[:, 0, :, 0, :], blocks[:, 1, :, 1, :]], axis=1).reshape(-1, 3, 3)
    size = mm_per_px(state, ends.place_mm)
    along = np.where(ends.met, 1e3, tuning.meet_px) * size
    own = own + (along**2)[:, None, None] * unit[:, :, None] * unit[:, None, :]
    information = np.linalg.inv(own)
    count = int(ends.corner.max()) + 1 if len(ends.corner) else 0
    total, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(total, ends.corner, information)
    np.add.at(right, ends.corner, (information @ ends.place_mm[:, :, None])[..., 0])
    covariance = np.linalg.inv(total)
    return LocatedCorners((covariance @ right[:, :, None])[..., 0], covariance)


def _units(lines_mm: Float[np.ndarray, "t 2 3"]) -> Float[np.ndarray, "t 3"]:
    way = lines_mm[:, 1] - lines_mm[:, 0]
    return way / np.linalg.norm(way, axis=1)[:, None]


class Hypotheses(NamedTuple):
    """Fields
    ------
    ends_mm : (n, 2, 3) where a line may begin, which is a corner, and where it may end.
    covariance_mm2 : (n, 6, 6) of them.
    """

    ends_mm: Float[np.ndarray, "n 2 3"]
    covariance_mm2: Float[np.ndarray, "n 6 6"]


def propose_partners(
    state: State, ends: JoinedEnds, corners: LocatedCorners, tuning: GuidedTuning
) -> Hypotheses:
    """From each corner both ways along lines near it, one of each direction, without those where a
    line begins already."""
    taken = _directions(state, ends, len(corners.place_mm))
    tracks = state.tracks
    way = tracks.ends_mm[:, 1] - tracks.ends_mm[:, 0]
    length = np.linalg.norm(way, axis=1)
    corner, line = _near_lines(state, corners, tuning)
    corner, line = np.tile(corner, 2), np.tile(line, 2)
    side = np.repeat([1.0, -1.0], len(line) // 2)
    unit = side[:, None] * (way / length[:, None])[line]
    free = _free(taken, corner, unit, tuning)
    corner, line, unit = corner[free], line[free], unit[free]
    reach = length[line]
    blocks = tracks.covariance_mm2[line].reshape(-1, 2, 3, 2, 3)
    turn = blocks[:, 0, :, 0] + blocks[:, 1, :, 1] - blocks[:, 0, :, 1] - blocks[:, 1, :, 0]
    start = corners.place_mm[corner]
    covariance = np.tile(corners.covariance_mm2[corner], (1, 2, 2))
    covariance[:, 3:, 3:] += turn
    lines = np.stack([start, start + reach[:, None] * unit], axis=1)
    long = reach > tuning.shortest_px * mm_per_px(state, lines.mean(axis=1))
    return Hypotheses(lines[long], covariance[long])


def _directions(state: State, ends: JoinedEnds, corners: int) -> Float[np.ndarray, "c k 3"]:
    """Unit vectors of the lines that leave each corner, from it into the line; zeros after them."""
    way = state.tracks.ends_mm[:, 1] - state.tracks.ends_mm[:, 0]
    unit = way / np.linalg.norm(way, axis=1)[:, None]
    outward = np.stack([unit, -unit], axis=1).reshape(-1, 3)
    order = np.argsort(ends.corner, kind="stable")
    corner = ends.corner[order]
    rank = np.arange(len(corner)) - np.searchsorted(corner, corner)
    found = np.zeros((corners, int(rank.max(initial=0)) + 1, 3))
    found[corner, rank] = outward[order]
    return found


def _free(
    taken: Float[np.ndarray, "c k 3"],
    corner: Int[np.ndarray, "n"],
    unit: Float[np.ndarray, "n 3"],
    tuning: GuidedTuning,
) -> Bool[np.ndarray, "n"]:
    """Whether no line leaves each corner in this direction yet."""
    alike = (taken[corner] @ unit[:, :, None])[..., 0].max(axis=1)
    return alike <= np.cos(np.radians(tuning.same_direction_deg))


def _near_lines(
    state: State, corners: LocatedCorners, tuning: GuidedTuning
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """(corner, line): of the lines nearest to each corner the longest of each direction."""
    ends = state.tracks.ends_mm
    way = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(way, axis=1)
    family = parallel_families(way / length[:, None], length, tuning.same_direction_deg)
    # The nearest lines by their three places.
    known = np.concatenate([ends[:, 0], ends.mean(axis=1), ends[:, 1]])
    most = min(3 * tuning.partners, len(known))
    near = KDTree(known).query(corners.place_mm, most)[1]
    line = (np.asarray(near).reshape(-1) % len(length)).astype(np.int64)
    corner = np.repeat(np.arange(len(corners.place_mm)), most)
    one = first_of_each(corner * len(length) + line)
    corner, line = corner[one], line[one]
    few = np.arange(len(corner)) - np.searchsorted(corner, corner) < tuning.partners
    corner, line = corner[few], line[few]
    longest = np.argsort(-length[line], kind="stable")
    corner, line = corner[longest], line[longest]
    one = first_of_each(corner * len(length) + family[line])
    return corner[one], line[one]


def parallel_families(
    unit: Float[np.ndarray, "t 3"], length: Float[np.ndarray, "t"], same_deg: float
) -> Int[np.ndarray, "t"]:
    """The family of each line: of those not in one yet the longest makes the next, with all that
    are parallel to it within `same_deg`."""
    family = np.full(len(unit), -1)
    for line in np.argsort(-length, kind="stable").tolist():
        if family[line] < 0:
            alike = np.abs(unit @ unit[line]) > np.cos(np.radians(same_deg))
            family[alike & (family < 0)] = family.max() + 1
    return family


def first_of_each(key: Int[np.ndarray, "n"]) -> Int[np.ndarray, "k"]:
    """The first row of each key, in the order of the keys' own rows."""
    return np.sort(np.unique(key, return_index=True)[1])
