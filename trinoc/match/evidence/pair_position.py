"""How much likelier two segments are as images of one line than as clutter.

Two views determine a line; only the ends are left to check it. In the notation of
`triple_position`, the evidence of place is 1 / (c prod_v (pixels per mm)) at each end, with c the
sine of the angle between the interpretation planes. Where segments are nearly parallel to
epipolar lines, their ends hardly correspond.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry import image_of_point
from trinoc.match.evidence.endpoints import LEAST_DENSITY
from trinoc.match.evidence.triple_position import log_lengths, project_onto_planes
from trinoc.match.observations import ClutterModel, SegmentTable
from trinoc.match.tuning import DEFAULT, CandidateTuning, EndTuning
from trinoc.match.two_view import (
    Pencil,
    PencilSegments,
    cut_pair,
    extents_on_line,
    image_length_px,
    interpretation_planes,
    points_of,
    sight_of,
)
from trinoc.numerics import (
    ArrayLike,
    Scalar,
    Symmetric3,
    Vector3,
    add3,
    cross3,
    dot3,
    in_front,
    largest_of,
    least_of,
    nth3,
    nth6,
    total,
    unit3,
)


class PairEvidence(NamedTuple):
    """What two segments say about being one line; fields as in TripleEvidence.

    end_log : (2, c) log density of each component, over clutter's: ends agree, by scale; or not.
    expected : in how many of the other views the line should be seen, as far as their
        borders go. crossing_sine : of the angle between their interpretation planes.
    """

    ends_mm: tuple[Vector3, Vector3]
    possible: Bool[ArrayLike, "..."]
    log_density: Scalar
    end_log: Float[ArrayLike, "2 c *h"]
    interval: tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]
    union_ends_mm: tuple[Vector3, Vector3]
    union_covariance_mm2: tuple[Symmetric3, Symmetric3]
    px_per_mm: Scalar
    expected: Scalar
    crossing_sine: Scalar


def pair_evidence(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    rows: tuple[PencilSegments, PencilSegments],
    segments: Int[ArrayLike, "2 *h"],
    clutter: ClutterModel,
    tuning: CandidateTuning = DEFAULT.candidates,
    ends: EndTuning = DEFAULT.ends,
) -> PairEvidence:
    """Evidence of one segment in each of two views; `rows` are the same in their pencil."""
    common = cut_pair(planes.baseline_mm, *rows, tuning)
    ends_mm = points_of(planes, common)
    step = add3(ends_mm[1], ends_mm[0], -1.0)
    length_mm = jnp.sqrt(dot3(step, step))
    along = unit3(step)
    sight = sight_of(lines, clutter, views, segments)
    low_mm, high_mm = extents_on_line(sight, ends_mm[0], along)
    places = jnp.zeros_like(length_mm), length_mm, least_of(low_mm), largest_of(high_mm)
    points = add3(in_front(ends_mm[0]), in_front(along), jnp.stack(places))
    sights = interpretation_planes(sight, points)
    sine = jnp.abs(dot3(along, cross3(nth3(sights.normal, 0), nth3(sights.normal, 1))))
    image_px = image_length_px(sights)
    px_per_mm = total(image_px) / (2 * length_mm)
    low, high = low_mm * px_per_mm[None], high_mm * px_per_mm[None]
    lengths = high - low
    log_density = (
        -2 * jnp.log(sine)
        - total(jnp.log(sights.px_per_mm[:, 0] * sights.px_per_mm[:, 1]))
        - jnp.log(length_mm * length_mm * px_per_mm)
        + total(jnp.log(image_px))
        + log_lengths(lengths, sight.typical_px)
        - total(sight.log_clutter)
    )
    longest, shortest = largest_of(lengths), least_of(lengths)
    slack = jnp.stack([total(row.end_variance_px2[e] for row in rows) for e in range(2)])
    difference = jnp.stack([low[0] - low[1], high[0] - high[1]])
    spread = project_onto_planes(sight, sights, points, along)[1]
    possible = common.possible & (sine > tuning.smallest_crossing) & jnp.isfinite(log_density)
    possible &= (shortest > tuning.shortest_to_longest * longest) & (common.high > common.low)
    components = _components(difference, slack, longest[None], ends)
    place = sights.interval
    return PairEvidence(
        ends_mm,
        possible,
        log_density,
        jnp.swapaxes(components, 0, 1),
        ((place[0, 0], place[0, 1]), (place[1, 0], place[1, 1])),
        (nth3(points, 2), nth3(points, 3)),
        (nth6(spread, 2), nth6(spread, 3)),
        px_per_mm,
        _views_expected(lines, views, segments, points),
        sine,
    )


def _components(
    difference: Scalar, slack: Scalar, longest: Scalar, tuning: EndTuning
) -> Float[ArrayLike, "c 2 *h"]:
    scale = np.array(tuning.agreeing_px, difference.dtype).reshape(-1, *(1,) * difference.ndim)
    variance = 2 * scale**2 + slack[None]
    density = jnp.exp(-0.5 * difference[None] ** 2 / variance) / jnp.sqrt(2 * np.pi * variance)
    agreeing = jnp.log(longest[None] * density + LEAST_DENSITY)
    return jnp.concatenate([agreeing, jnp.zeros_like(difference)[None]])


def _views_expected(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    segments: Int[ArrayLike, "2 *h"],
    points_mm: Vector3,
) -> Float[ArrayLike, "*h"]:
    """Number of other views within whose borders, and before which, the first two points lie."""
    every = np.arange(lines.matrix_px.shape[-3])
    items = (1,) * (segments.ndim - 1)
    view = every.reshape(-1, *items)
    camera = view if lines.frame is None else (lines.frame[views[0], segments[0]][None], view)
    x, y, z = (coordinate[:2] for coordinate in points_mm)
    (u, v), depth = image_of_point(lines.matrix_px[camera][:, None], in_front((x, y, z)))
    size = lines.size_px[camera][:, None]
    inside = (depth > 0) & (u > 0) & (u < size[..., 0]) & (v > 0) & (v < size[..., 1])
    other = (views[0] != every) & (views[1] != every)
    seen = inside.all(axis=1) & other.reshape(-1, *items)
    return seen.astype(u.dtype).sum(axis=0)
