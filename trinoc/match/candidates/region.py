"""Where lines lie: a box in space that is learned from a sample of them.

Most pairs of segments of two views would lie before or behind the scene, if they were one line. In
a pencil of epipolar planes the box is a range of disparities, so that such pairs are never made.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.single_precision import SingleOrder
from trinoc.match.observations import PAIRS_IN_BLOCK, SegmentTable, block_of
from trinoc.match.tuning import CandidateTuning, ScoutTuning
from trinoc.match.two_view import Pencil, PencilSegments, cut_pair, row_of
from trinoc.numerics import ArrayLike, add3, in_blocks, kept_jit, times_matrix, vector3


class Region(NamedTuple):
    """A box: low_mm < axes @ point < high_mm, with unit rows of `axes`."""

    axes: Float[np.ndarray, "3 3"]
    low_mm: Float[np.ndarray, "3"]
    high_mm: Float[np.ndarray, "3"]


def region_of(ends_mm: Float[np.ndarray, "m 2 3"], tuning: ScoutTuning) -> Region:
    """The box along the axes of their spread that holds nearly all ends of some lines, and more."""
    points = ends_mm.reshape(-1, 3)
    axes = np.linalg.eigh(np.cov(points.T))[1].T
    places = points @ axes.T
    low, high = np.quantile(places, [tuning.left_out, 1 - tuning.left_out], axis=0)
    # A scene of one plane has lines beside it.
    wider = np.maximum(tuning.margin * (high - low), tuning.thinnest * (high - low).max())
    return Region(axes, low - wider, high + wider)


class RegionOfPencil(NamedTuple):
    """A region as rays of a pencil meet it: of a point with homogeneous coordinates (slope, cos,
    sin, 1 / radius), `turned` @ ray lies between `low` / radius and `high` / radius."""

    turned: Float[ArrayLike, "3 3"]
    low: Float[ArrayLike, "3"]
    high: Float[ArrayLike, "3"]


def region_of_pencil(region: Region, planes: Pencil) -> RegionOfPencil:
    """The region in the frame of a pencil, in single precision."""
    origin = region.axes @ np.asarray(planes.origin_mm)
    turned = region.axes @ np.asarray(planes.frame).T
    parts = turned, region.low_mm - origin, region.high_mm - origin
    return RegionOfPencil(*(part.astype(np.float32) for part in parts))


def pairs_within(
    lines: SegmentTable,
    single: SingleOrder,
    region: RegionOfPencil,
    i: Int[np.ndarray, "p"],
    j: Int[np.ndarray, "p"],
    tuning: CandidateTuning,
) -> tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]:
    """Those pairs that would be lines of which the common part lies in a region."""
    pair = single.view.baseline_mm, single.first, single.second

    def inside(i: np.ndarray, j: np.ndarray) -> ArrayLike:
        return _lies_within(region, *pair, i, j, tuning=tuning)

    keep = np.flatnonzero(in_blocks(inside, block_of(lines, PAIRS_IN_BLOCK), i, j))
    return i[keep], j[keep]


@partial(kept_jit, static_argnames=("tuning",))
def _lies_within(
    region: RegionOfPencil,
    baseline_mm: Float[ArrayLike, ""],
    first: PencilSegments,
    second: PencilSegments,
    i: Int[ArrayLike, "p"],
    j: Int[ArrayLike, "p"],
    tuning: CandidateTuning,
) -> Bool[ArrayLike, "p"]:
    """Whether pairs have a common part of which both ends lie in a region."""
    part = cut_pair(baseline_mm, row_of(first, i), row_of(second, j), tuning)
    inside = part.possible
    for at in (part.at_low, part.at_high):
        place = times_matrix(region.turned, at[:3])
        below, above = (add3(place, vector3(bound), -at[3]) for bound in (region.low, region.high))
        for k in range(3):
            inside &= (below[k] > 0) & (above[k] < 0)
    return jnp.asarray(inside)
