"""Where a lamp casts an edge: in the plane of the two, beyond the edge.

A line is the shadow of an edge where the plane through the lamp and the edge holds it, the edge
lies between it and the lamp, and rays from the lamp through the edge reach it. All that is needed
of a pair are the places of the shadow's ends and of the lamp in three axes of the edge: along it,
across it in the plane of both lines, and normal to that plane.
"""

from collections.abc import Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from trinoc.geometry.segments import Segments
from trinoc.match.line_map.corners import Corners
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.bodies import ShadowTuning
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.vectors import complete_axes, cross_3d


class Plane(NamedTuple):
    """normal : unit, toward the cameras. members : the lines in it."""

    normal: Float[np.ndarray, "3"]
    members: Bool[np.ndarray, "e"]


def suggest_planes(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    cameras_mm: Float[np.ndarray, "3"],
    tuning: ShadowTuning,
) -> list[Plane]:
    """Planes that two lines that are not parallel suggest, those of the longest lines first.

    `cameras_mm` is the middle of the cameras. A line may lie in several planes.
    """
    length = np.linalg.norm(lines_mm[:, 1] - lines_mm[:, 0], axis=1)
    way = (lines_mm[:, 1] - lines_mm[:, 0]) / length[:, None]
    first, second = np.triu_indices(len(lines_mm), 1)
    normal = cross_3d(way[first], way[second])
    sine = np.linalg.norm(normal, axis=1)
    turned = sine > tuning.least_sine
    first, second, normal = first[turned], second[turned], normal[turned] / sine[turned, None]
    offset = 0.5 * np.einsum("pi,pi->p", normal, lines_mm[first, 0] + lines_mm[second, 0])
    near = _lies_in_plane(lines_mm, covariance_mm2, normal, offset, length, tuning)
    order = np.arange(len(first))
    good = near[order, first] & near[order, second]
    normal, offset, near = normal[good], offset[good], near[good]
    weight = near @ np.minimum(length, np.median(length) if len(length) else 0.0)
    left, found = np.ones(len(normal), dtype=bool), []
    while left.any():
        best = int(np.argmax(np.where(left, weight, -1.0)))
        members = near[best]
        if members.sum() < tuning.fewest_in_plane:
            break
        points = lines_mm[members].reshape(-1, 3)
        middle = points.mean(axis=0)
        across = np.linalg.svd(points - middle)[2][2]
        across = across if across @ (cameras_mm - middle) > 0 else -across
        fit = (across[None], (across @ middle)[None])
        own = _lies_in_plane(lines_mm, covariance_mm2, *fit, length, tuning)[0]
        if own.sum() >= tuning.fewest_in_plane:
            found.append(Plane(across, own))
        left &= (near & members).sum(axis=1) < 0.5 * near.sum(axis=1)
        left[best] = False
    return found


def _lies_in_plane(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    normal: Float[np.ndarray, "p 3"],
    offset: Float[np.ndarray, "p"],
    length: Float[np.ndarray, "e"],
    tuning: ShadowTuning,
) -> Bool[np.ndarray, "p e"]:
    """Which lines lie in which plane with both ends, and are known well enough to tell."""
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    own = np.stack([blocks[:, 0, :, 0], blocks[:, 1, :, 1]], axis=1)
    outer = normal[:, :, None] * normal[:, None]
    sigma = np.sqrt(np.maximum(np.tensordot(outer, own, axes=([1, 2], [2, 3])), 0.0))
    gap = np.abs(np.tensordot(normal, lines_mm, axes=(1, 2)) - offset[:, None, None])
    scale = tuning.flatness * np.median(length)
    near = (gap < tuning.plane_sigmas * sigma + scale) & (sigma < 5 * scale)
    return near.all(axis=2)


def side_levels_of_lines(
    matches: Matches, segments: Mapping[str, Segments | ArrayLike], joined: JoinedLines
) -> Float[np.ndarray, "e v 2"]:
    """Logarithms of the darker and of the brighter level beside each line; NaN where not known."""
    found = np.full((len(joined), len(matches.views), 2), np.nan)
    for view, name in enumerate(matches.views):
        own = segments[name]
        levels = own.side_levels if isinstance(own, Segments) else None
        seen = np.flatnonzero(matches.index[:, view] >= 0)
        if levels is None or len(seen) == 0:
            continue
        pair = np.sort(np.asarray(levels)[matches.index[seen, view]], axis=1)
        good = np.isfinite(pair).all(axis=1)
        line, pair = (
            joined.line_of_track[seen[good]],
            np.log(pair[good] + DEFAULT.shadows.dark_level),
        )
        count = np.bincount(line, minlength=len(joined))
        for side in (0, 1):
            total = np.bincount(line, pair[:, side], minlength=len(joined))
            known = count > 0
            found[known, view, side] = total[known] / count[known]
    return found


def evidence_of_surroundings(
    joined: JoinedLines,
    corners: Corners,
    planes: list[Plane],
    levels: Float[np.ndarray, "e v 2"],
    tuning: ShadowTuning,
) -> Float[np.ndarray, "e 4"]:
    """For each line: whether it stands between two corners from which lines leave its plane,
    whether one of its ends is the corner of a body, how many lines of its plane have the same
    levels beside them (log of one more), and how much darker its one side is (log ratio)."""
    count = len(joined)
    step = joined.lines_mm[:, 1] - joined.lines_mm[:, 0]
    length = np.linalg.norm(step, axis=1)
    way = step / length[:, None]
    body, leaving = np.zeros((count, 2), dtype=bool), np.zeros((count, 2), dtype=bool)
    normal = np.zeros((count, 3))
    for plane in sorted(planes, key=_members):
        normal[plane.members] = plane.normal
    for corner in range(len(corners)):
        rows = np.flatnonzero(corners.corner == corner)
        for row in rows.tolist():
            line, end = corners.line[row], corners.end[row]
            others = corners.line[rows[rows != row]]
            leaving[line, end] = (np.abs(way[others] @ normal[line]) > tuning.least_sine).any()
            body[line, end] = any(
                abs(way[line] @ cross_3d(way[one], way[two])) > tuning.least_sine
                for one, two in combinations(others.tolist(), 2)
            )
    alike = np.zeros(count)
    for plane in planes:
        rows = np.flatnonzero(plane.members)
        apart = levels[rows, None] - levels[rows]
        known = np.isfinite(apart)
        number = known.sum(axis=(2, 3)) / 2
        square = np.where(known, (apart / tuning.level_sigma) ** 2, 0.0).sum(axis=(2, 3))
        same = np.where(number > 0, np.exp(-0.5 * square / np.maximum(number, 1)), 0.0)
        np.fill_diagonal(same, 0.0)
        share = np.minimum(length[rows] / np.median(length), 2.0)
        alike[rows] = np.maximum(alike[rows], same @ share)
    ratio = levels[:, :, 1] - levels[:, :, 0]
    known = np.isfinite(ratio)
    mean = np.where(known, ratio, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    # Nothing is known where no level is: as of a line like others.
    mean = np.where(known.any(axis=1), mean, tuning.usual_ratio)
    return np.stack(
        [leaving.all(axis=1), body.any(axis=1), np.log1p(alike), mean - tuning.usual_ratio], axis=1
    ).astype(np.float64)


def _members(plane: Plane) -> int:
    return int(plane.members.sum())


# numerical: beyond so many sigmas a density is less than 4e-6 of its peak.
FAR_SIGMAS = 5.0
# numerical: share of `ShadowTuning.room` by which a shadow may begin before its edge.
BEFORE = 0.3


class ShadowPairs(NamedTuple):
    """Lines that may be the shadows of others.

    shadow, edge : numbers of the lines. axes : of each edge, rows. middle_mm : the scene's middle
    from the edge's first end, in these axes. ends_mm : both ends of the shadow, likewise.
    length_mm : of the edge. own_mm2 : variances of the shadow's ends normal to the plane.
    edge_mm2 : of the edge's ends, and their covariance.
    """

    shadow: Int[np.ndarray, "p"]
    edge: Int[np.ndarray, "p"]
    axes: Float[np.ndarray, "p 3 3"]
    middle_mm: Float[np.ndarray, "p 3"]
    ends_mm: Float[np.ndarray, "p 2 3"]
    length_mm: Float[np.ndarray, "p"]
    own_mm2: Float[np.ndarray, "p 2"]
    edge_mm2: Float[np.ndarray, "p 3"]


class Lamps(NamedTuple):
    """direction : unit, from the scene's middle. nearness : 1 over the distance from there, per mm;
    0 for a lamp so far that its light is parallel."""

    direction: Float[np.ndarray, "l 3"]
    nearness: Float[np.ndarray, "l"]


def casting_pairs(
    lines_mm: Float[np.ndarray, "e 2 3"],
    covariance_mm2: Float[np.ndarray, "e 6 6"],
    middle_mm: Float[np.ndarray, "3"],
    tuning: ShadowTuning,
) -> ShadowPairs:
    """Every two lines that lie in one plane within errors and the turn of a coarse search."""
    count = len(lines_mm)
    shadow, edge = np.nonzero(~np.eye(count, dtype=bool))
    step = lines_mm[:, 1] - lines_mm[:, 0]
    length = np.linalg.norm(step, axis=1)
    way = step / length[:, None]
    across = complete_axes(way)
    offset = lines_mm[shadow] - lines_mm[edge, None, 0]
    flat = offset @ across[edge].mT
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    own = np.stack([blocks[:, 0, :, 0], blocks[:, 1, :, 1]], axis=1)
    loose = np.trace(own, axis1=2, axis2=3)[shadow] / 2
    loose = loose + (np.radians(tuning.coarse_deg / 2) * np.linalg.norm(flat, axis=2)) ** 2
    spread = np.einsum("pei,pej,pe->pij", flat, flat, 1 / loose)
    square, turn = np.linalg.eigh(spread)
    near = square[:, 0] < tuning.plane_sigmas**2
    shadow, edge, turn = shadow[near], edge[near], turn[near]
    normal = np.einsum("pi,pij->pj", turn[:, :, 0], across[edge])
    axes = np.stack([way[edge], np.cross(normal, way[edge]), normal], axis=1)
    between = blocks[:, 0, :, 1]
    sides = (own[edge, 0], own[edge, 1], between[edge])
    return ShadowPairs(
        shadow,
        edge,
        axes,
        np.einsum("pai,pi->pa", axes, middle_mm - lines_mm[edge, 0]),
        np.einsum("pai,pei->pea", axes, lines_mm[shadow] - lines_mm[edge, None, 0]),
        length[edge],
        np.einsum("pi,peij,pj->pe", normal, own[shadow], normal),
        np.stack([np.einsum("pi,pij,pj->p", normal, part, normal) for part in sides], axis=1),
    )


def likely_casts(
    pairs: ShadowPairs, lamps: Lamps, turn: float, size_mm: float, tuning: ShadowTuning
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Lamps and pairs whose `cast_density` may count, by their numbers: few of all.

    There an end lies |off| <= k (sigma + turn gap) from the plane of lamp and edge, k = FAR_SIGMAS.
    Both sides times `reach`, which `off` and `beyond` are divided by in `cast_density`, are linear
    in the lamp as a homogeneous point, but for `reach` itself; what else grows with a near lamp
    does by at most `farthest`, the length of the way to the lamp from any place. Of sigma the
    largest is taken. Single precision serves a bound.
    """
    lamp = np.column_stack([lamps.direction, lamps.nearness]).astype(np.float32)
    toward = np.concatenate([pairs.axes, pairs.middle_mm[:, :, None]], axis=2)
    first, second = toward[:, 1], toward[:, 2]
    reach = np.sqrt(np.square(lamp @ _single(first).T) + np.square(lamp @ _single(second).T))
    from_middle = np.stack([np.zeros_like(pairs.ends_mm), pairs.ends_mm]) - pairs.middle_mm[:, None]
    farthest = 1 + lamps.nearness.max() * np.linalg.norm(from_middle, axis=-1).max()
    of_first, of_second, of_both = pairs.edge_mm2.T
    # Of the edge's line, one of its lengths beyond either end.
    moved = np.maximum(4 * of_first + of_second, of_first + 4 * of_second) - 4 * of_both
    sigmas, before = FAR_SIGMAS * farthest, BEFORE * tuning.room * size_mm
    near, casts = reach > tuning.least_sine / 2, np.zeros(reach.shape, dtype=bool)
    for end in (0, 1):
        place = pairs.ends_mm[:, end, :, None]
        off = lamp @ _single(first * place[:, 2] - second * place[:, 1]).T
        beyond = lamp @ _single(-first * place[:, 1] - second * place[:, 2]).T
        sigma = np.sqrt(pairs.own_mm2[:, end]) + np.sqrt(moved) + turn * before
        bound = _single(sigmas * sigma) * reach
        bound += np.float32(sigmas * turn) * np.maximum(beyond, 0)
        near &= np.abs(off) * reach <= bound
        casts |= beyond > 0
    which, pair = np.nonzero(near & casts)
    return which, pair


def _single(array: np.ndarray) -> Float32[np.ndarray, "..."]:
    return array.astype(np.float32)


def cast_density(
    pairs: ShadowPairs, lamps: Lamps, turn: float, size_mm: float, tuning: ShadowTuning
) -> Float[np.ndarray, "n"]:
    """How likely each shadow's ends are where they are if the edge casts it, of one lamp for each
    pair, up to a factor of the shadow; lamps are `turn` (rad) unsure."""
    near = lamps.nearness
    # From a point of the edge's axes to the lamp: this less `near` times the point.
    toward = np.einsum("pai,pi->ap", pairs.axes, lamps.direction) + near * pairs.middle_mm.T
    along, first, second = toward
    reach = np.sqrt(first**2 + second**2)
    square, variances, at, gaps, cut = 0.0, 1.0, [], [], []
    for end in (0, 1):
        place = pairs.ends_mm[:, end]
        off = (first * place[:, 2] - second * place[:, 1]) / reach
        beyond = -(first * place[:, 1] + second * place[:, 2]) / reach
        rise, run = reach + near * beyond, along - near * place[:, 0]
        part = beyond / np.where(np.abs(rise) < 1e-9, 1e-9, rise)
        gap = part * np.sqrt(rise**2 + run**2)
        where = place[:, 0] + part * run
        share = np.clip(where / pairs.length_mm, -1.0, 2.0)
        of_first, of_second, of_both = pairs.edge_mm2.T
        moved = (1 - share) ** 2 * of_first + share**2 * of_second
        moved = moved + 2 * share * (1 - share) * of_both
        moved = moved / np.clip(1 - near * part, 0.05, None) ** 2
        variance = pairs.own_mm2[:, end] + moved + (turn * gap) ** 2
        square, variances = square + off**2 / variance, variances * variance
        at.append(where)
        gaps.append(gap)
        cut.append(near * part)
    low, high, room = np.minimum(*at), np.maximum(*at), tuning.room * size_mm
    reached = np.minimum(high, pairs.length_mm + room) - np.maximum(low, -room)
    reached = np.clip((reached / np.maximum(high - low, 1e-9) - 0.4) / 0.4, 0.0, 1.0)
    beyond = (np.minimum(*gaps) > -BEFORE * room) & (np.maximum(*cut) < 0.9)
    beyond &= np.maximum(*gaps) > 0
    density = np.exp(-0.5 * square) / np.sqrt(variances) / pairs.length_mm
    return np.where(beyond, reached * density, 0.0)
