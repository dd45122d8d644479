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
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.observations import SegmentTable
from trinoc.match.two_view.pencil_segments import PencilSegments
from trinoc.numerics import ArrayLike, cross3, dot3, namespace_of, scaled3, vector3


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


def pencil(lines: SegmentTable, a: Int[ArrayLike, ""] | int, b: Int[ArrayLike, ""] | int) -> Pencil:
    """The pencil of views a and b.

    In NumPy outside `jit`: each segment is placed once, which takes less than compiling it would.
    """
    xp = namespace_of(lines, a, b)
    lines = jax.tree.map(xp.asarray, lines)
    across = lines.centre_mm[..., b, :] - lines.centre_mm[..., a, :]
    baseline = xp.sqrt((across**2).sum(-1))
    axis = across / baseline[..., None]
    # Angle zero lies in the middle of what the cameras look at, and the jump behind them.
    forward = lines.matrix_px[..., a, 2, :3] + lines.matrix_px[..., b, 2, :3]
    first = forward - (forward * axis).sum(-1)[..., None] * axis
    first = first / xp.sqrt((first**2).sum(-1))[..., None]
    frame = xp.stack([axis, first, xp.cross(axis, first)], axis=-2)

    views = xp.stack([xp.asarray(a), xp.asarray(b)])
    homography = frame[..., None, :, :] @ lines.inverse[..., views, :, :]
    if lines.frame is None:
        homography = homography[:, None]
    else:
        homography = homography[lines.frame[views], xp.arange(2)[:, None]]
    # A segment in a plane with the baseline has slopes that are infinite, as it has under `jit`.
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = _in_pencil(
            homography, lines.ends_px[views], lines.line[views, :, :2], lines.across_px2[views]
        )
    both = PencilSegments(first), PencilSegments(second)
    return Pencil(frame, lines.centre_mm[..., a, :], baseline, *both)


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
    homography: Float[ArrayLike, "2 *n 3 3"],
    ends_px: Float[ArrayLike, "2 n 2 2"],
    line_normal: Float[ArrayLike, "2 n 2"],
    across_px2: Float[ArrayLike, "2 n 2 2"],
) -> Float[ArrayLike, "2 c n"]:
    """The columns of both views' segments; `homography` takes homogeneous pixels to rays in the
    frame."""
    xp = namespace_of(homography, ends_px)
    rows = [vector3(homography[..., k, :]) for k in range(3)]
    # Both ends in front: (2, view, n).
    u, v = xp.moveaxis(ends_px, -1, 0).transpose(0, 3, 1, 2)
    x, y, z = (c0[None] * u + c1[None] * v + c2[None] for c0, c1, c2 in rows)
    first = xp.arctan2(z[0], y[0])
    turn = xp.arctan2(y[0] * z[1] - z[0] * y[1], y[0] * y[1] + z[0] * z[1])
    normal = cross3((x[0], y[0], z[0]), (x[1], y[1], z[1]))
    p, q = -normal[1] / normal[0], -normal[2] / normal[0]
    # An error across the segment moves the ray by `across`; on its own plane angle that is so much
    # slope. It turns the end's plane as so much way along the segment would.
    nu, nv = line_normal[..., 0], line_normal[..., 1]
    across = [c0 * nu + c1 * nv for c0, c1, _ in rows]
    along = [c0 * nv - c1 * nu for c0, c1, _ in rows[1:]]
    push = (normal[0] * across[0] + normal[1] * across[1] + normal[2] * across[2]) / normal[0]
    slope_per_px = push[None] / xp.sqrt(y * y + z * z)
    turned, by_way = (y * w[1][None] - z * w[0][None] for w in (across[1:], along))
    slide_per_px = turned / by_way
    own = xp.stack([across_px2[..., 0, 0], across_px2[..., 1, 1]])
    ends = xp.stack([first, first + turn]), slope_per_px**2 * own, slide_per_px**2 * own
    swap = turn[None] < 0
    angles, variance, end_variance = (xp.where(swap, end[::-1], end) for end in ends)
    (low, high), cosine, sine = angles, xp.cos(angles), xp.sin(angles)
    unit = scaled3(normal, 1 / xp.sqrt(dot3(normal, normal)))
    together = slope_per_px[0] * slope_per_px[1] * across_px2[..., 0, 1]
    columns = (
        *(low, high, cosine[0], sine[0], cosine[1], sine[1], p, q, *unit),
        *(variance[0], together, variance[1], *end_variance),
    )
    return xp.stack(columns, axis=1)


def plane_angles(
    lines: SegmentTable, view: int, segments: PencilSegments
) -> Float[np.ndarray, "n 2"]:
    """Plane angles of all ends of a view, low and high; those of other frames lie apart."""
    angles = np.stack([np.asarray(segments.low), np.asarray(segments.high)], axis=1)
    if lines.frame is None:
        return angles
    # Half a turn on either side, and not more than another for what one segment spans.
    return angles + 16.0 * np.asarray(lines.frame)[view][:, None]
