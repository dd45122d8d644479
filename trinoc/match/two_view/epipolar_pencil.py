"""The pencil of epipolar planes of two views, in which a match in depth is one division.

In the frame (axis, first, second), with the axis along the baseline, a viewing ray has a plane
angle phi = atan2(second, first), equal for partners, and a slope, axis over radius, which
differs between partners by baseline / radius of the point: the pencil is to wide baselines
what rows and disparity are to rectified pictures, and stays defined with the epipoles inside
the pictures. A segment's interpretation plane, m . ray = 0, makes its slope a sinusoid of the
angle: slope = p cos phi + q sin phi.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.observations import SegmentTable
from trinoc.numerics import ArrayLike, kept_jit


class PencilSegments(NamedTuple):
    """The segments of one view in a pencil, one column per quantity.

    low, high : plane angles of the ends, in rad, without a jump between them; cosine_low, ...
    their cosines and sines. p, q : coefficients of the slope. normal : of the plane.
    slope_variance : (c00, c01, c11) of the slopes at the angles low and high, due to the
        errors of the ends across the segment. end_variance_px2 : of the places along the
        segment, at low and high, that have the plane angles of a partner's ends.
    """

    low: Float[ArrayLike, "*n"]
    high: Float[ArrayLike, "*n"]
    cosine_low: Float[ArrayLike, "*n"]
    sine_low: Float[ArrayLike, "*n"]
    cosine_high: Float[ArrayLike, "*n"]
    sine_high: Float[ArrayLike, "*n"]
    p: Float[ArrayLike, "*n"]
    q: Float[ArrayLike, "*n"]
    normal: tuple[Float[ArrayLike, "*n"], Float[ArrayLike, "*n"], Float[ArrayLike, "*n"]]
    slope_variance: tuple[Float[ArrayLike, "*n"], Float[ArrayLike, "*n"], Float[ArrayLike, "*n"]]
    end_variance_px2: tuple[Float[ArrayLike, "*n"], Float[ArrayLike, "*n"]]


class Pencil(NamedTuple):
    """Frame of the planes through two centres, and the segments of both views in it.

    frame : rows axis, first, second. origin_mm : centre of the first view.
    baseline_mm : distance of the centres. Of each frame of a stack.
    """

    frame: Float[ArrayLike, "*f 3 3"]
    origin_mm: Float[ArrayLike, "*f 3"]
    baseline_mm: Float[ArrayLike, "*f"]
    first: PencilSegments
    second: PencilSegments


@kept_jit
def pencil(lines: SegmentTable, a: Int[ArrayLike, ""], b: Int[ArrayLike, ""]) -> Pencil:
    """The pencil of views a and b."""

    def axes(
        centre_mm: Float[ArrayLike, "v 3"], matrix_px: Float[ArrayLike, "v 3 4"]
    ) -> tuple[Float[ArrayLike, "3 3"], Float[ArrayLike, ""]]:
        across = centre_mm[b] - centre_mm[a]
        baseline = jnp.sqrt(across @ across)
        axis = across / baseline
        # Angle zero lies in the middle of what the cameras look at, and the jump behind them.
        forward = matrix_px[a, 2, :3] + matrix_px[b, 2, :3]
        first = forward - (forward @ axis) * axis
        first = first / jnp.sqrt(first @ first)
        return jnp.stack([axis, first, jnp.cross(axis, first)]), baseline

    each = axes if lines.frame is None else jax.vmap(axes)
    frame, baseline = each(lines.centre_mm, lines.matrix_px)

    def segments(view: Int[ArrayLike, ""]) -> PencilSegments:
        homography = frame @ lines.inverse[..., view, :, :]
        if lines.frame is not None:
            homography = homography[lines.frame[view]]
        place = jax.vmap(_in_pencil, in_axes=(None if lines.frame is None else 0, 0, 0, 0))
        return place(
            homography, lines.ends_px[view], lines.line[view, :, :2], lines.across_px2[view]
        )

    both = jax.vmap(segments)(jnp.stack([jnp.asarray(a), jnp.asarray(b)]))
    first, second = (jax.tree.map(lambda column: column[k], both) for k in range(2))  # noqa: B023
    return Pencil(frame, lines.centre_mm[..., a, :], baseline, first, second)


def pencil_of(
    planes: Pencil, lines: SegmentTable, view: Int[ArrayLike, ""], segment: Int[ArrayLike, "..."]
) -> Pencil:
    """The pencil with the planes of some segments' frames alone."""
    if lines.frame is None:
        return planes
    frame = lines.frame[view, segment]
    return planes._replace(
        frame=planes.frame[frame],
        origin_mm=planes.origin_mm[frame],
        baseline_mm=planes.baseline_mm[frame],
    )


def _in_pencil(
    homography: Float[ArrayLike, "3 3"],
    ends_px: Float[ArrayLike, "2 2"],
    line_normal: Float[ArrayLike, "2"],
    across_px2: Float[ArrayLike, "2 2"],
) -> PencilSegments:
    """One segment; `homography` takes homogeneous pixels to rays in the frame."""
    rays = jnp.stack([homography @ jnp.append(ends_px[e], 1.0) for e in range(2)])
    first = jnp.arctan2(rays[0, 2], rays[0, 1])
    turn = jnp.arctan2(rays[0, 1] * rays[1, 2] - rays[0, 2] * rays[1, 1], rays[0, 1:] @ rays[1, 1:])
    normal = jnp.cross(rays[0], rays[1])
    p, q = -normal[1] / normal[0], -normal[2] / normal[0]

    def slope_per_px(ray: Float[ArrayLike, "3"]) -> Float[ArrayLike, ""]:
        # An error moves the ray by `push`; on its own plane angle that is this much slope.
        push = homography[:, :2] @ line_normal
        radius = jnp.hypot(ray[1], ray[2])
        return normal @ push / (normal[0] * radius)

    def slide_per_px(ray: Float[ArrayLike, "3"]) -> Float[ArrayLike, ""]:
        # An error across the segment turns the end's plane as so much way along it would.
        direction = jnp.stack([line_normal[1], -line_normal[0]])
        across, along = homography[1:, :2] @ line_normal, homography[1:, :2] @ direction
        return (ray[1] * across[1] - ray[2] * across[0]) / (ray[1] * along[1] - ray[2] * along[0])

    slide = [slide_per_px(rays[e]) ** 2 * across_px2[e, e] for e in range(2)]
    effect = jnp.stack([slope_per_px(rays[0]), slope_per_px(rays[1])])
    variance = jnp.outer(effect, effect) * across_px2
    swap = turn < 0
    low, high = jnp.where(swap, first + turn, first), jnp.where(swap, first, first + turn)
    unit = normal / jnp.sqrt(normal @ normal)
    return PencilSegments(
        low,
        high,
        jnp.cos(low),
        jnp.sin(low),
        jnp.cos(high),
        jnp.sin(high),
        p,
        q,
        (unit[0], unit[1], unit[2]),
        (
            jnp.where(swap, variance[1, 1], variance[0, 0]),
            variance[0, 1],
            jnp.where(swap, variance[0, 0], variance[1, 1]),
        ),
        (jnp.where(swap, slide[1], slide[0]), jnp.where(swap, slide[0], slide[1])),
    )


def row_of(table: PencilSegments, index: Int[ArrayLike, "*p"]) -> PencilSegments:
    """The segments of given numbers."""
    return jax.tree.map(lambda column: column[index], table)


def plane_angles(
    lines: SegmentTable, view: int, segments: PencilSegments
) -> Float[np.ndarray, "n 2"]:
    """Plane angles of all ends of a view, low and high; those of other frames lie apart."""
    angles = np.stack([np.asarray(segments.low), np.asarray(segments.high)], axis=1)
    if lines.frame is None:
        return angles
    # Half a turn on either side, and not more than another for what one segment spans.
    return angles + 16.0 * np.asarray(lines.frame)[view][:, None]
