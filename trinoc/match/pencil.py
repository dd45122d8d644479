"""The pencil of epipolar planes of two views, in which a match in depth is one division.

In the frame (axis, first, second), with the axis along the baseline, a viewing ray has a plane
angle atan2(second, first), equal for partners, and a slope, axis over radius, which differs
by baseline / radius of the point: the pencil is to wide baselines what rows and disparity
are to rectified pictures, and stays defined with the epipoles inside the pictures.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from trinoc.geometry.arrays import ArrayLike
from trinoc.match.picture_lines import PictureLines


class Pencil(NamedTuple):
    """Frame of the planes through two centres, and the segments of both views in it.

    frame : rows axis, first, second. origin_mm : centre of the first view.
    baseline_mm : distance of the centres.
    rays_a, rays_b : (n, 2, 3) viewing rays of both ends of each segment, in the frame.
    angles_a, angles_b : (n, 2) plane angles of the ends, low and high, in rad, without a jump.
    """

    frame: Float[ArrayLike, "3 3"]
    origin_mm: Float[ArrayLike, "3"]
    baseline_mm: Float[ArrayLike, ""]
    rays_a: Float[ArrayLike, "n 2 3"]
    rays_b: Float[ArrayLike, "n 2 3"]
    angles_a: Float[ArrayLike, "n 2"]
    angles_b: Float[ArrayLike, "n 2"]


@jax.jit
def pencil(lines: PictureLines, a: Int[ArrayLike, ""], b: Int[ArrayLike, ""]) -> Pencil:
    """The pencil of views a and b."""
    across = lines.centre_mm[b] - lines.centre_mm[a]
    baseline = jnp.sqrt(across @ across)
    axis = across / baseline
    # Angle zero lies in the middle of what the cameras look at, and the jump behind them.
    forward = lines.matrix_px[a, 2, :3] + lines.matrix_px[b, 2, :3]
    first = forward - (forward @ axis) * axis
    first = first / jnp.sqrt(first @ first)
    frame = jnp.stack([axis, first, jnp.cross(axis, first)])

    def rays(view: Int[ArrayLike, ""]) -> Float[ArrayLike, "n 2 3"]:
        ends = lines.ends_px[view]
        homogeneous = jnp.concatenate([ends, jnp.ones_like(ends[..., :1])], axis=-1)
        return homogeneous @ (frame @ lines.inverse[view]).T

    rays_a, rays_b = rays(a), rays(b)
    angles = jax.vmap(_angles)
    return Pencil(
        frame, lines.centre_mm[a], baseline, rays_a, rays_b, angles(rays_a), angles(rays_b)
    )


def _angles(rays: Float[ArrayLike, "2 3"]) -> Float[ArrayLike, "2"]:
    first = jnp.arctan2(rays[0, 2], rays[0, 1])
    cross = rays[0, 1] * rays[1, 2] - rays[0, 2] * rays[1, 1]
    second = first + jnp.arctan2(cross, rays[0, 1:] @ rays[1, 1:])
    return jnp.stack([jnp.minimum(first, second), jnp.maximum(first, second)])


def slope_at(
    rays: Float[ArrayLike, "2 3"], cosine: Float[ArrayLike, ""], sine: Float[ArrayLike, ""]
) -> Float[ArrayLike, ""]:
    """Axis over radius of the ray in which a segment meets the plane of an angle."""
    off_plane = cosine * rays[:, 2] - sine * rays[:, 1]
    along = cosine * rays[:, 1] + sine * rays[:, 2]
    # The ray where the segment crosses the plane is the ends' mean, weighted crosswise.
    return (off_plane[1] * rays[0, 0] - off_plane[0] * rays[1, 0]) / (
        off_plane[1] * along[0] - off_plane[0] * along[1]
    )


def point_on_plane(
    pencil: Pencil,
    rays_a: Float[ArrayLike, "2 3"],
    rays_b: Float[ArrayLike, "2 3"],
    angle_rad: Float[ArrayLike, ""],
) -> tuple[Float[ArrayLike, "3"], Float[ArrayLike, ""]]:
    """(point, radius) of a pair of segments on one epipolar plane; radius > 0 in front."""
    cosine, sine = jnp.cos(angle_rad), jnp.sin(angle_rad)
    slope = slope_at(rays_a, cosine, sine)
    radius = pencil.baseline_mm / (slope - slope_at(rays_b, cosine, sine))
    return pencil.origin_mm + radius * (jnp.stack([slope, cosine, sine]) @ pencil.frame), radius
