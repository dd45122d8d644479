"""Cylinders that two outlines in one view and one in another suggest.

The axis lies in the plane through the centre of projection half-way between the planes of both
outlines, and along the plane of the third: that is its direction. Its distance and its radius grow
in proportion from the first view, and the third plane touches at one distance on either side:
six equations, five unknowns.
"""

from itertools import permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.bodies.cylinder_fit import Members
from trinoc.match.bodies.outlines import Outlines, abreast_mm, before_camera, ray_axis_distances
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.vectors import cross_3d

# numerical: pairs and third outlines looked at together: they bound the memory.
AT_ONCE = 1 << 18
# numerical: of each view, those that share most, as many as there is time for.
MOST_PAIRS = 1000
# numerical: those of the longest outlines, as many as memory holds.
MOST_HYPOTHESES = 40_000


class Start(NamedTuple):
    """Cylinders to begin with, and the three outlines of each."""

    members: Members
    point_mm: Float[np.ndarray, "h 3"]
    direction: Float[np.ndarray, "h 3"]
    radius_mm: Float[np.ndarray, "h"]


class _Pairs(NamedTuple):
    """Two outlines of one view. row : in the table. normal : of the plane half-way between."""

    row: Int[np.ndarray, "p 2"]
    normal: Float[np.ndarray, "p 3"]


def propose_cylinders(table: Outlines, views: int, tuning: MatchTuning) -> Start:
    """All that are roughly consistent."""
    nothing = np.zeros((0, 3))
    found = [Start(Members(np.zeros((0, 3), np.int64), nothing), nothing, nothing, np.zeros(0))]
    pairs = [_pairs_of_view(table, view, tuning) for view in range(views)]
    for first, second in permutations(range(views), 2):
        third = np.flatnonzero(table.view == second)
        count = len(pairs[first].row) * len(third)
        for part in blocks(count, AT_ONCE):
            i, j = np.divmod(np.arange(count)[part], len(third))
            found += _consistent(table, take_rows(pairs[first], i), third[j], tuning)
    every = concatenate_rows(found)
    # The table begins with the longest.
    kept = np.argsort(every.members.row.sum(axis=1), kind="stable")[:MOST_HYPOTHESES]
    return take_rows(every, kept)


def _pairs_of_view(table: Outlines, view: int, tuning: MatchTuning) -> _Pairs:
    """Nearly parallel segments abreast of each other, the longest first where they are many."""
    rows = np.flatnonzero(table.view == view)
    ends, length = table.ends_px[rows], table.length_px[rows]
    way = (ends[:, 1] - ends[:, 0]) / length[:, None]
    i, j = np.triu_indices(len(rows), 1)
    dot = (way[i] * way[j]).sum(axis=1)
    mean = way[i] + np.sign(dot)[:, None] * way[j]
    mean = mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-12)[:, None]
    middle = 0.5 * (ends[i].mean(axis=1) + ends[j].mean(axis=1))
    reach = [np.sort(((ends[k] - middle[:, None]) * mean[:, None]).sum(-1), axis=1) for k in (i, j)]
    common = np.minimum(reach[0][:, 1], reach[1][:, 1]) - np.maximum(reach[0][:, 0], reach[1][:, 0])
    good = np.abs(dot) > np.cos(np.radians(tuning.cylinders.parallel_deg))
    good &= common > tuning.tracks.abreast_share * np.minimum(length[i], length[j])
    gap = ends[j].mean(axis=1) - ends[i].mean(axis=1)
    wide = np.abs(gap[:, 0] * mean[:, 1] - gap[:, 1] * mean[:, 0])
    good &= wide > tuning.cylinders.narrowest_px
    chosen = np.flatnonzero(good)
    chosen = chosen[np.argsort(-common[chosen], kind="stable")][:MOST_PAIRS]
    row = np.stack([rows[i[chosen]], rows[j[chosen]]], axis=1)
    normal = table.normals[row]
    turn = np.sign((normal[:, 0] * normal[:, 1]).sum(axis=1))
    between = normal[:, 0] + turn[:, None] * normal[:, 1]
    between = between / np.maximum(np.linalg.norm(between, axis=1), 1e-12)[:, None]
    return _Pairs(row, between)


def _consistent(
    table: Outlines, pairs: _Pairs, third: Int[np.ndarray, "h"], tuning: MatchTuning
) -> list[Start]:
    """Cylinders that the pairs and a third outline touch, one for each of its sides."""
    every = table.normals
    normal = every[third]
    axis = cross_3d(pairs.normal, normal)
    size = np.linalg.norm(axis, axis=1)
    own = every[pairs.row]
    out_of = np.abs((own * axis[:, None]).sum(axis=2)).max(axis=1)
    kept = np.flatnonzero(out_of < size * np.sin(np.radians(tuning.cylinders.parallel_deg)))
    row = np.concatenate([pairs.row[kept], third[kept, None]], axis=1)
    normal, direction = normal[kept], axis[kept] / size[kept, None]
    centre = table.rays.centre_mm[row]
    away = cross_3d(direction, pairs.normal[kept])
    middle = table.rays.ray[row[:, :2]].sum(axis=(1, 2))
    away = away * np.sign((away * middle).sum(axis=1))[:, None]
    first = take_rows(table.rays, row[:, :2])
    beside = ray_axis_distances(
        first, (centre[:, 0] + away)[:, None], direction[:, None]
    ).distance_mm
    share = np.abs(beside.mean(axis=2)).mean(axis=1)
    base = (normal * (centre[:, 2] - centre[:, 0])).sum(axis=1)
    slope = (normal * away).sum(axis=1)
    found = []
    for side in (1.0, -1.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = base / (slope - side * share)
        good = np.flatnonzero(np.isfinite(distance) & (distance > 0))
        point = centre[good, 0] + distance[good, None] * away[good]
        found.append(
            _before_cameras(
                table, row[good], point, direction[good], (distance * share)[good], tuning
            )
        )
    return found


def _before_cameras(
    table: Outlines,
    row: Int[np.ndarray, "h 3"],
    point_mm: Float[np.ndarray, "h 3"],
    direction: Float[np.ndarray, "h 3"],
    radius_mm: Float[np.ndarray, "h"],
    tuning: MatchTuning,
) -> Start:
    """Those that lie before the cameras, with outlines abreast of each other on both sides."""
    rays = take_rows(table.rays, row)
    side = np.sign(
        ray_axis_distances(rays, point_mm[:, None], direction[:, None]).distance_mm.mean(axis=2)
    )
    along = np.sort(abreast_mm(rays, point_mm[:, None], direction[:, None]), axis=2)
    common = along[..., 1].min(axis=1) - along[..., 0].max(axis=1)
    shortest = (along[..., 1] - along[..., 0]).min(axis=1)
    place = point_mm + along.mean(axis=(1, 2))[:, None] * direction
    good = (side[:, 0] != side[:, 1]) & (common > tuning.tracks.abreast_share * shortest)
    good &= before_camera(rays, place[:, None]).all(axis=1)
    return take_rows(Start(Members(row, side), place, direction, radius_mm), good)
