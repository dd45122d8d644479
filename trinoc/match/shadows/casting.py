"""Where a lamp casts an edge: in the plane of the two, beyond the edge.

A line is the shadow of an edge where the plane through the lamp and the edge holds it, the edge
lies between it and the lamp, and rays from the lamp through the edge reach it. All that is needed
of a pair are the places of the shadow's ends and of the lamp in three axes of the edge: along it,
across it in the plane of both lines, and normal to that plane.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.tuning import ShadowTuning
from trinoc.numerics import axes_across


class Pairs(NamedTuple):
    """Lines that may be the shadows of others, ordered by shadow.

    shadow, edge : numbers of the lines. axes : of each edge, rows. middle_mm : the scene's middle
    from the edge's first end, in these axes. ends_mm : both ends of the shadow, likewise.
    length_mm : of the edge. own_mm2 : variances of the shadow's ends normal to the plane; edge_mm2
    those of the edge's ends and their covariance. floor_mm : what no error is below.
    """

    shadow: Int[np.ndarray, "p"]
    edge: Int[np.ndarray, "p"]
    axes: Float[np.ndarray, "p 3 3"]
    middle_mm: Float[np.ndarray, "p 3"]
    ends_mm: Float[np.ndarray, "p 2 3"]
    length_mm: Float[np.ndarray, "p"]
    own_mm2: Float[np.ndarray, "p 2"]
    edge_mm2: Float[np.ndarray, "p 3"]
    floor_mm: float


class Lamps(NamedTuple):
    """direction : unit, from the scene's middle. nearness : 1 over the distance from there, per mm;
    0 for a lamp so far that its light is parallel."""

    direction: Float[np.ndarray, "l 3"]
    nearness: Float[np.ndarray, "l"]

    def take(self, rows: np.ndarray) -> "Lamps":
        """Some of them."""
        return Lamps(self.direction[rows], self.nearness[rows])


def casting_pairs(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    middle_mm: Float[np.ndarray, "3"],
    size_mm: float,
    tuning: ShadowTuning,
) -> Pairs:
    """Every two lines that lie in one plane within errors, and within the turn of a coarse search.

    `size_mm` is the scene's.
    """
    count = len(lines_mm)
    shadow, edge = np.nonzero(~np.eye(count, dtype=bool))
    step = lines_mm[:, 1] - lines_mm[:, 0]
    length = np.linalg.norm(step, axis=1)
    way = step / length[:, None]
    across = axes_across(way)
    offset = lines_mm[shadow] - lines_mm[edge, None, 0]
    flat = offset @ across[edge].mT
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    own = np.stack([blocks[:, 0, :, 0], blocks[:, 1, :, 1]], axis=1)
    floor = tuning.floor * size_mm
    loose = np.trace(own, axis1=2, axis2=3)[shadow] / 2 + floor**2
    loose = loose + (np.radians(tuning.coarse_deg / 2) * np.linalg.norm(flat, axis=2)) ** 2
    spread = np.einsum("pei,pej,pe->pij", flat, flat, 1 / loose)
    square, turn = np.linalg.eigh(spread)
    near = square[:, 0] < tuning.coplanar_chi_square
    shadow, edge, turn = shadow[near], edge[near], turn[near]
    normal = np.einsum("pi,pij->pj", turn[:, :, 0], across[edge])
    axes = np.stack([way[edge], np.cross(normal, way[edge]), normal], axis=1)
    between = blocks[:, 0, :, 1]
    sides = (own[edge, 0], own[edge, 1], between[edge])
    return Pairs(
        shadow,
        edge,
        axes,
        np.einsum("pai,pi->pa", axes, middle_mm - lines_mm[edge, 0]),
        np.einsum("pai,pei->pea", axes, lines_mm[shadow] - lines_mm[edge, None, 0]),
        length[edge],
        np.einsum("pi,peij,pj->pe", normal, own[shadow], normal),
        np.stack([np.einsum("pi,pij,pj->p", normal, part, normal) for part in sides], axis=1),
        floor,
    )


def cast_density(
    pairs: Pairs, lamps: Lamps, turn: float, size_mm: float, tuning: ShadowTuning
) -> Float[np.ndarray, "l p"]:
    """How likely each shadow's ends are where they are if the edge casts it, per lamp, up to a
    factor of the shadow; lamps are `turn` (rad) unsure."""
    toward = np.einsum("li,pai->lpa", lamps.direction, pairs.axes)
    near = lamps.nearness[:, None]
    # From a point of the edge's axes to the lamp: this less `near` times the point.
    toward = toward + near[:, :, None] * pairs.middle_mm
    along, first, second = toward[..., 0], toward[..., 1], toward[..., 2]
    reach = np.maximum(np.hypot(first, second), 1e-9)
    square, variances, at, gaps, cut = 0.0, 1.0, [], [], []
    for end in (0, 1):
        place = pairs.ends_mm[:, end]
        off = (first * place[:, 2] - second * place[:, 1]) / reach
        beyond = -(first * place[:, 1] + second * place[:, 2]) / reach
        rise, run = reach + near * beyond, along - near * place[:, 0]
        part = beyond / np.where(np.abs(rise) < 1e-9, 1e-9, rise)
        gap = part * np.hypot(rise, run)
        where = place[:, 0] + part * run
        share = np.clip(where / pairs.length_mm, -1.0, 2.0)
        of_first, of_second, of_both = pairs.edge_mm2.T
        moved = (1 - share) ** 2 * of_first + share**2 * of_second
        moved = moved + 2 * share * (1 - share) * of_both
        moved = moved / np.clip(1 - near * part, 0.05, None) ** 2
        variance = pairs.own_mm2[:, end] + moved + (turn * gap) ** 2 + pairs.floor_mm**2
        square, variances = square + off**2 / variance, variances * variance
        at.append(where)
        gaps.append(gap)
        cut.append(near * part)
    low, high, room = np.minimum(*at), np.maximum(*at), tuning.room * size_mm
    reached = np.minimum(high, pairs.length_mm + room) - np.maximum(low, -room)
    reached = np.clip((reached / np.maximum(high - low, 1e-9) - 0.4) / 0.4, 0.0, 1.0)
    beyond = (np.minimum(*gaps) > -0.3 * room) & (np.maximum(*gaps) > tuning.least_gap * size_mm)
    beyond &= (reach > tuning.least_sine / 2) & (np.maximum(*cut) < 0.9)
    density = np.exp(-0.5 * square) / np.sqrt(variances) / pairs.length_mm
    return np.where(beyond, reached * density, 0.0)
