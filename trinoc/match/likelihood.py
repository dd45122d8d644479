"""How much likelier three segments are as images of one line than as three strangers.

Across a line in space lies a plane in which the three planes of sight are three lines with unit
normals n_v. Since two normals span that plane, c_1 n_1 + c_2 n_2 + c_3 n_3 = 0 with c_1 the
sine between n_2 and n_3, and so on round. So r = sum_v c_v d_v, with d_v the distance of a point
from plane v, does not depend on the point: it is what remains of three views when the two
unknowns are gone, whichever pair the line came from. With a flat prior on the line, the evidence
of the three places is exactly N(r; 0, S) / prod_v (pixels per mm), at both ends together.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from trinoc.geometry.arrays import ArrayLike
from trinoc.geometry.lines import nearest_on_line
from trinoc.match.fragments import SMALLEST_OVERLAP, SightPlane, project, sight_plane
from trinoc.match.picture_lines import PictureLines

# Chi-square, 2 degrees of freedom, up to which three segments can be one line.
GATE = 16.0
# The common part at which the evidence is taken is held to this share of the whole line.
SHORTEST_TO_LONGEST = 0.2


class TripleEvidence(NamedTuple):
    """What three segments say about being one line.

    ends_mm : ends of the part common to all, adjusted to all three views.
    possible : whether there is such a part, near enough to all.
    chi_square : of the place and direction, under the segments' own covariances.
    log_density : logarithm of the evidence of places over that of three strangers, apart from
        the density of lines in space and the heavy tail; log_spread : log det S / 2 is in it.
    extent_px : (3, 2) where each view's segment begins and ends along the line, in mean pixels.
    part : (3, 2) the common part on each segment, 0 at its first end and 1 at its second.
    """

    ends_mm: Float[ArrayLike, "2 3"]
    possible: Bool[ArrayLike, ""]
    chi_square: Float[ArrayLike, ""]
    log_density: Float[ArrayLike, ""]
    extent_px: Float[ArrayLike, "3 2"]
    part: Float[ArrayLike, "3 2"]


def triple_evidence(
    lines: PictureLines,
    views: Int[ArrayLike, "3"],
    segments: Int[ArrayLike, "3"],
    ends_mm: Float[ArrayLike, "2 3"],
    log_strangers: Float[ArrayLike, "v"],
    typical_px: Float[ArrayLike, ""],
) -> TripleEvidence:
    """Evidence of one segment in each of three views, near a line given by two points.

    `log_strangers` is, per view, log N / (pi A): segments per pixel of area and radian, and
    `typical_px` the usual length of a segment.
    """
    origin, along = ends_mm[0], ends_mm[1] - ends_mm[0]
    along = along / jnp.sqrt(along @ along)
    extents = jnp.stack([_extent(lines, views[k], segments[k], origin, along) for k in range(3)])
    low, high = jnp.sort(extents, axis=1)[:, 0], jnp.sort(extents, axis=1)[:, 1]
    length = jnp.sort(high - low)
    begin, end = low.max(), high.min()
    common = end - begin
    safe = jnp.where(common > 0, common, 1.0)
    points = origin + jnp.stack([begin, begin + safe])[:, None] * along

    planes = [sight_plane(lines, views[k], segments[k], points) for k in range(3)]
    normals = jnp.stack([plane.normal for plane in planes])
    c = jnp.stack([along @ jnp.cross(normals[(k + 1) % 3], normals[(k + 2) % 3]) for k in range(3)])
    distance = jnp.stack([plane.offset_px / plane.px_per_mm for plane in planes])
    covariance = jnp.stack([p.covariance_px2 / jnp.outer(p.px_per_mm, p.px_per_mm) for p in planes])
    r, s = c @ distance, jnp.einsum("v,vij->ij", c * c, covariance)
    determinant = s[0, 0] * s[1, 1] - s[0, 1] ** 2
    chi_square = (
        s[1, 1] * r[0] ** 2 - 2 * s[0, 1] * r[0] * r[1] + s[0, 0] * r[1] ** 2
    ) / determinant

    image_length = jnp.stack([_image_length(lines, views[k], points) for k in range(3)])
    extents_px = (jnp.stack([low, high], axis=1) - begin) * image_length.mean() / safe
    log_density = (
        -0.5 * jnp.log(determinant)
        - sum(jnp.log(p.px_per_mm).sum() for p in planes)
        - jnp.log(safe * image_length.mean())
        + jnp.log(image_length).sum()
        + _log_lengths(extents_px, typical_px)
        - log_strangers[views].sum()
    )
    possible = common > SMALLEST_OVERLAP * length[0]
    possible &= (chi_square < GATE) & (length[1] > SHORTEST_TO_LONGEST * length[2])
    return TripleEvidence(
        _adjusted(points, along, planes, distance, covariance),
        possible & jnp.isfinite(log_density),
        chi_square,
        log_density,
        extents_px,
        jnp.stack([_part(lines, views[k], segments[k], points) for k in range(3)]),
    )


def _extent(
    lines: PictureLines,
    view: Int[ArrayLike, ""],
    segment: Int[ArrayLike, ""],
    origin: Float[ArrayLike, "3"],
    along: Float[ArrayLike, "3"],
) -> Float[ArrayLike, "2"]:
    """Positions on a line in space, in mm, where the rays of a segment's ends pass."""
    ends = lines.ends_px[view, segment]
    rays = [lines.inverse[view] @ jnp.append(ends[e], 1.0) for e in range(2)]
    return jnp.stack([nearest_on_line(origin, along, lines.centre_mm[view], ray) for ray in rays])


def _log_lengths(
    extent_px: Float[ArrayLike, "v 2"], typical_px: Float[ArrayLike, ""]
) -> Float[ArrayLike, ""]:
    """Log density of one length over those of strangers, with ends uniform on the longest.

    Lengths are spread as t / (length + t)^2, with t the typical one.
    """
    length = extent_px[:, 1] - extent_px[:, 0]
    longest, views = length.max(), len(length)
    density = jnp.log(typical_px) - 2 * jnp.log(length + typical_px)
    density_longest = jnp.log(typical_px) - 2 * jnp.log(longest + typical_px)
    return density_longest - density.sum() - 2 * (views - 1) * jnp.log(longest)


def _image_length(
    lines: PictureLines, view: Int[ArrayLike, ""], points: Float[ArrayLike, "2 3"]
) -> Float[ArrayLike, ""]:
    image, _ = project(lines.matrix_px[view], points)
    step = image[1] - image[0]
    return jnp.sqrt(step @ step)


def _part(
    lines: PictureLines,
    view: Int[ArrayLike, ""],
    segment: Int[ArrayLike, ""],
    points: Float[ArrayLike, "2 3"],
) -> Float[ArrayLike, "2"]:
    """Where two points in space lie along a segment, from 0 at its first end to 1."""
    image, _ = project(lines.matrix_px[view], points)
    ends = lines.ends_px[view, segment]
    step = ends[1] - ends[0]
    return (image - ends[0]) @ step / (step @ step)


def _adjusted(
    points: Float[ArrayLike, "2 3"],
    along: Float[ArrayLike, "3"],
    planes: list[SightPlane],
    distance: Float[ArrayLike, "3 2"],
    covariance: Float[ArrayLike, "3 2 2"],
) -> Float[ArrayLike, "2 3"]:
    """Move two points across the line to the weighted least-squares fit of all planes."""
    first = planes[0].normal
    second = jnp.cross(along, first)
    basis = jnp.stack([first, second])
    n = jnp.stack([basis @ plane.normal for plane in planes])

    def moved(end: int) -> Float[ArrayLike, "3"]:
        weight = 1 / covariance[:, end, end]
        a = jnp.einsum("v,vi,vj->ij", weight, n, n)
        b = jnp.einsum("v,vi,v->i", weight, n, distance[:, end])
        shift = jnp.stack([a[1, 1] * b[0] - a[0, 1] * b[1], a[0, 0] * b[1] - a[0, 1] * b[0]])
        return points[end] - shift @ basis / (a[0, 0] * a[1, 1] - a[0, 1] ** 2)

    return jnp.stack([moved(0), moved(1)])
