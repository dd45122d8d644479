"""The rays of pixels through a lens, and where they meet the sheet."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry import AbstractLens
from trinoc.numerics import ArrayLike

# Pieces of one length, so that another number of pixels does not compile again.
_PIECE = 8192


class Ray(NamedTuple):
    """A pixel after the lens: fixed while the pose moves, so it is computed once.

    Fields
    ------
    direction : (3,) of the pixel's centre in the camera frame, of any length.
    by_pixel : (3, 2) derivative of `direction` with respect to (u, v).
    bend : (3, 3) second derivatives by uu, uv and vv, by which straight edges look curved; None
        for a lens that keeps lines straight.
    """

    direction: Float[ArrayLike, "3"]
    by_pixel: Float[ArrayLike, "3 2"]
    bend: Float[ArrayLike, "3 3"] | None = None

    def moved(self, du: Float[ArrayLike, ""], dv: Float[ArrayLike, ""]) -> "Ray":
        """The ray of a place (du, dv) pixels aside, by the lens's derivatives here."""
        direction, by_pixel = [], []
        for k in range(3):
            by_u, by_v = self.by_pixel[k, 0], self.by_pixel[k, 1]
            aside = self.direction[k] + by_u * du + by_v * dv
            if self.bend is not None:
                uu, uv, vv = (self.bend[k, j] for j in range(3))
                aside = aside + 0.5 * (uu * du * du + vv * dv * dv) + uv * du * dv
                by_u, by_v = by_u + uu * du + uv * dv, by_v + uv * du + vv * dv
            direction.append(aside)
            by_pixel.append(jnp.stack([by_u, by_v]))
        return Ray(jnp.stack(direction), jnp.stack(by_pixel), self.bend)


class SheetPoint(NamedTuple):
    """A pixel's point on the sheet.

    Fields
    ------
    point_mm : (2,) (X, Y).
    by_pixel : (2, 2) A, derivative of the point with respect to (u, v), mm per px.
    depth_slope : (2,) w, derivative of the logarithm of the homogeneous coordinate, per px:
        the second derivatives of the point are -(A_ij w_k + A_ik w_j), and `bend`.
    by_matrix : (3,) ray / homogeneous coordinate, which carries a change of the homography:
        d point_i = (dM_i - point_i dM_2) . by_matrix, for rows M_i.
    unit : 1, used as a fusion barrier. XLA computes cheap elementwise values again at every use;
        dividing by a 1 that it cannot see through makes it compute them once.
    bend : (2, 3) second derivatives by uu, uv and vv that the lens adds; None for none.
    """

    point_mm: Float[ArrayLike, "2"]
    by_pixel: Float[ArrayLike, "2 2"]
    depth_slope: Float[ArrayLike, "2"]
    by_matrix: Float[ArrayLike, "3"]
    unit: Float[ArrayLike, ""]
    bend: Float[ArrayLike, "2 3"] | None = None


def sheet_point(
    sheet_from_camera: Float[ArrayLike, "3 3"], ray: Ray, unit: Float[ArrayLike, ""]
) -> SheetPoint:
    """The point of a ray under the homography M from directions in the camera to the sheet.

    Written in scalars: over thousands of pixels the compiler fuses them into one loop, which
    it does not do for products of small matrices.
    """
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = sheet_from_camera
    x, y, z = ray.direction[0], ray.direction[1], ray.direction[2]
    scale = 1 / (m20 * x + m21 * y + m22 * z)
    point_x = (m00 * x + m01 * y + m02 * z) * scale
    point_y = (m10 * x + m11 * y + m12 * z) * scale
    depth = (m20 * scale, m21 * scale, m22 * scale)
    of_x = [m * scale - point_x * d for m, d in zip((m00, m01, m02), depth, strict=True)]
    of_y = [m * scale - point_y * d for m, d in zip((m10, m11, m12), depth, strict=True)]

    def along(row: Sequence[ArrayLike], columns: ArrayLike, count: int) -> Float[ArrayLike, "k"]:
        return jnp.stack([sum(row[k] * columns[k, j] for k in range(3)) for j in range(count)])

    bend = None
    if ray.bend is not None:
        bend = jnp.stack([along(of_x, ray.bend, 3), along(of_y, ray.bend, 3)])
    return SheetPoint(
        jnp.stack([point_x, point_y]),
        jnp.stack([along(of_x, ray.by_pixel, 2), along(of_y, ray.by_pixel, 2)]),
        along(depth, ray.by_pixel, 2),
        jnp.stack([x * scale, y * scale, z * scale]),
        unit,
        bend,
    )


def rays_of_pixels(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"], *, with_bend: bool = True
) -> Ray:
    """The ray of each pixel: (n, 3) directions, (n, 3, 2) and (n, 3, 3) their derivatives."""
    if lens.has_distortion:
        return _through_distortion(lens, uv_px, with_bend)
    (fu, fv), (cu, cv) = np.asarray(lens.focal_length_px), np.asarray(lens.principal_point_px)
    skew = float(lens.skew_px)
    y = (uv_px[:, 1] - cv) / fv
    direction = np.stack([(uv_px[:, 0] - cu - skew * y) / fu, y, np.ones_like(y)], axis=1)
    by_pixel = np.array([[1 / fu, -skew / (fu * fv)], [0.0, 1 / fv], [0.0, 0.0]])
    return Ray(direction, np.broadcast_to(by_pixel, (len(uv_px), 3, 2)))


def _through_distortion(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"], with_bend: bool
) -> Ray:
    padded = np.concatenate([uv_px, np.zeros((-len(uv_px) % _PIECE, 2))])
    pieces = [
        _distorted_rays(lens, padded[k : k + _PIECE], with_bend=with_bend)
        for k in range(0, len(padded), _PIECE)
    ]
    return jax.tree.map(
        lambda *parts: np.concatenate([np.asarray(part) for part in parts])[: len(uv_px)], *pieces
    )


@partial(jax.jit, static_argnames="with_bend")
def _distorted_rays(lens: AbstractLens, uv_px: Float[ArrayLike, "n 2"], *, with_bend: bool) -> Ray:
    def ray(uv: Float[ArrayLike, "2"]) -> Ray:
        first = jax.jacfwd(lens.unproject)
        if not with_bend:
            return Ray(lens.unproject(uv), first(uv))
        second = jax.jacfwd(first)(uv)
        bend = jnp.stack([second[:, 0, 0], second[:, 0, 1], second[:, 1, 1]], axis=1)
        return Ray(lens.unproject(uv), first(uv), bend)

    return jax.vmap(ray)(uv_px)
