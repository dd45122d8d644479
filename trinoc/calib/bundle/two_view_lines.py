"""Lines that two views show: where the planes of their two fragments meet, exactly."""

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.bundle.schur import FragmentTable
from trinoc.calib.model import CameraState
from trinoc.geometry import line_of_planes, line_through, plane_of_line
from trinoc.numerics import ArrayLike


def placed_by_two_views(
    cameras: CameraState, anchors_mm: Float[ArrayLike, "t 2 3"], tracks: FragmentTable
) -> Float[ArrayLike, "t 2 3"]:
    """Anchors with those of the lines seen in two views at the nearest points of their line.

    Others stay, as do lines whose two planes coincide.
    """

    def placed(anchors: ArrayLike, fragments_px: ArrayLike, seen: ArrayLike) -> ArrayLike:
        planes = jax.vmap(_plane)(cameras, fragments_px)
        last = seen.shape[0] - 1 - jnp.argmax(seen[::-1])
        point, direction = line_of_planes(planes[jnp.argmax(seen)], planes[last])
        along = (anchors - point[None, :]) @ direction
        line = point[None, :] + along[:, None] * direction[None, :]
        return jnp.where((jnp.sum(seen) == 2) & jnp.all(jnp.isfinite(line)), line, anchors)

    return jax.vmap(placed)(anchors_mm, tracks.fragments_px, tracks.seen)


def _plane(camera: CameraState, fragment_px: Float[ArrayLike, "2 2"]) -> Float[ArrayLike, "4"]:
    ends = jax.vmap(camera.undistorted)(fragment_px)
    plane = plane_of_line(camera.matrix_px, line_through(ends[0], ends[1]))
    return plane / jnp.sqrt(plane[:3] @ plane[:3])
