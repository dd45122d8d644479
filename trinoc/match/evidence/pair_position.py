"""How much likelier two segments are as images of one line than as clutter.

Two views determine a line; only the ends are left to check it. In the notation of
`triple_position`, the evidence of place is 1 / (c prod_v (pixels per mm)) at each end, with c the
sine of the angle between the interpretation planes. Where segments are nearly parallel to
epipolar lines, their ends hardly correspond.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from trinoc.match.evidence.endpoints import LEAST_DENSITY
from trinoc.match.evidence.triple_position import adjusted, log_lengths
from trinoc.match.observations import ClutterModel, SegmentTable
from trinoc.match.tuning import DEFAULT, CandidateTuning, EndTuning
from trinoc.match.two_view import (
    Pencil,
    PencilSegments,
    cut_pair,
    extent_on_line,
    image_of,
    interpretation_plane,
    points_of,
)
from trinoc.numerics import ArrayLike, Scalar, Symmetric3, Vector3, add3, cross3, dot3, total, unit3


class PairEvidence(NamedTuple):
    """What two segments say about being one line; fields as in TripleEvidence.

    end_log : (2, c) log density of each component, over clutter's: ends agree, by scale; or not.
    expected : in how many of the other views the line should be seen, as far as their
        borders go.
    """

    ends_mm: tuple[Vector3, Vector3]
    possible: Bool[ArrayLike, ""]
    log_density: Scalar
    end_log: tuple[tuple[Scalar, ...], tuple[Scalar, ...]]
    interval: tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]
    union_ends_mm: tuple[Vector3, Vector3]
    union_covariance_mm2: tuple[Symmetric3, Symmetric3]
    px_per_mm: Scalar
    expected: Scalar


def pair_evidence(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    rows: tuple[PencilSegments, PencilSegments],
    segments: Int[ArrayLike, "2"],
    clutter: ClutterModel,
    tuning: CandidateTuning = DEFAULT.candidates,
    ends: EndTuning = DEFAULT.ends,
) -> PairEvidence:
    """Evidence of one segment in each of two views; `rows` are the same in their pencil."""
    common = cut_pair(planes.baseline_mm, *rows, tuning)
    points = points_of(planes, common)
    step = add3(points[1], points[0], -1.0)
    length_mm = jnp.sqrt(dot3(step, step))
    along = unit3(step)
    sights = [interpretation_plane(lines, views[k], segments[k], points) for k in range(2)]
    sine = jnp.abs(dot3(along, cross3(sights[0].normal, sights[1].normal)))
    px_per_mm = (sights[0].length_px + sights[1].length_px) / (2 * length_mm)
    extents = [extent_on_line(lines, views[k], segments[k], points[0], along) for k in range(2)]
    low = [jnp.minimum(a, b) * px_per_mm for a, b in extents]
    high = [jnp.maximum(a, b) * px_per_mm for a, b in extents]
    lengths = [high[k] - low[k] for k in range(2)]
    log_density = (
        -2 * jnp.log(sine)
        - total(jnp.log(s.px_per_mm[0] * s.px_per_mm[1]) for s in sights)
        - jnp.log(length_mm * length_mm * px_per_mm)
        + total(jnp.log(s.length_px) for s in sights)
        + log_lengths(lengths, clutter.typical_px)
        - total(clutter.log_density[views[k], segments[k]] for k in range(2))
    )
    longest = jnp.maximum(lengths[0], lengths[1])
    shortest = jnp.minimum(lengths[0], lengths[1])
    slack = [total(row.end_variance_px2[e] for row in rows) for e in range(2)]
    outer = (
        add3(points[0], along, jnp.minimum(low[0], low[1]) / px_per_mm),
        add3(points[0], along, jnp.maximum(high[0], high[1]) / px_per_mm),
    )
    outer_sights = [interpretation_plane(lines, views[k], segments[k], outer) for k in range(2)]
    spread = [adjusted(outer[e], e, along, outer_sights)[1] for e in range(2)]
    possible = common.possible & (sine > tuning.smallest_crossing) & jnp.isfinite(log_density)
    possible &= (shortest > tuning.shortest_to_longest * longest) & (common.high > common.low)
    return PairEvidence(
        points,
        possible,
        log_density,
        (
            _components(low[0] - low[1], slack[0], longest, ends),
            _components(high[0] - high[1], slack[1], longest, ends),
        ),
        (sights[0].interval, sights[1].interval),
        outer,
        (spread[0], spread[1]),
        px_per_mm,
        _views_expected(lines, views, points),
    )


def _components(
    difference: Scalar, slack: Scalar, longest: Scalar, tuning: EndTuning
) -> tuple[Scalar, ...]:
    def agreeing(scale: float) -> Scalar:
        variance = 2 * scale**2 + slack
        density = jnp.exp(-0.5 * difference**2 / variance) / jnp.sqrt(2 * np.pi * variance)
        return jnp.log(longest * density + LEAST_DENSITY)

    return (*(agreeing(scale) for scale in tuning.agreeing_px), jnp.zeros_like(difference))


def _views_expected(
    lines: SegmentTable, views: Int[ArrayLike, "2"], points: tuple[Vector3, Vector3]
) -> Scalar:
    """Number of other views within whose borders, and before which, both points lie."""
    expected = jnp.zeros_like(points[0][0])
    for view in range(lines.matrix_px.shape[0]):
        width, height = lines.size_px[view, 0], lines.size_px[view, 1]
        inside = (views[0] != view) & (views[1] != view)
        for point in points:
            (u, v), depth = image_of(lines.matrix_px[view], point)
            inside &= (depth > 0) & (u > 0) & (u < width) & (v > 0) & (v < height)
        expected = expected + jnp.where(inside, 1.0, 0.0)
    return expected
