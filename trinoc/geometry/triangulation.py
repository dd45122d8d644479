"""A segment in space from its fragments in two or more views, with covariance.

Maximum likelihood: the two ends that minimise the Mahalanobis distance of their images from
the ends of the fragments. The fragments' covariance is large along the segment, so that
views hardly argue about the ends' place along the line, and agree on the line itself.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from trinoc.geometry.epipolar import centre_of_matrix
from trinoc.numerics import (
    ArrayLike,
    inverse_3x3,
    inverse_positive_definite,
    solve_positive_definite,
)

GAUSS_NEWTON_STEPS = 4


class Segment3D(NamedTuple):
    """Two ends (2, 3) in mm, their covariance (6, 6), and the chi-square of the fit."""

    ends_mm: Float[ArrayLike, "2 3"]
    covariance_mm2: Float[ArrayLike, "6 6"]
    chi_square: Float[ArrayLike, ""]


def triangulate_point(
    matrices_px: Float[ArrayLike, "v 3 4"],
    uv_px: Float[ArrayLike, "v 2"],
    weight: Float[ArrayLike, "v"],
) -> Float[ArrayLike, "3"]:
    """The point nearest to the viewing rays of `uv_px`, in weighted least squares (mm)."""

    def normal_equations(
        matrix_px: Float[ArrayLike, "3 4"], uv: Float[ArrayLike, "2"]
    ) -> tuple[Float[ArrayLike, "3 3"], Float[ArrayLike, "3"]]:
        ray = inverse_3x3(matrix_px[:, :3]) @ jnp.append(uv, 1.0)
        across = jnp.eye(3) - jnp.outer(ray, jnp.asarray(ray)) / (ray @ ray)
        return across, across @ centre_of_matrix(matrix_px)

    across, right = jax.vmap(normal_equations)(matrices_px, uv_px)
    return solve_positive_definite(
        jnp.einsum("v,vij->ij", weight, across), jnp.einsum("v,vi->i", weight, right)
    )


def triangulate_segment(
    matrices_px: Float[ArrayLike, "v 3 4"],
    fragments_px: Float[ArrayLike, "v 2 2"],
    covariance_px2: Float[ArrayLike, "v 4 4"],
    seen: Bool[ArrayLike, "v"],
) -> Segment3D:
    """Maximum-likelihood segment from corresponding fragments (undistorted pixels).

    Views that are not `seen` may hold anything, NaN included. The covariance is that of the
    least-squares estimate, (J^T W J)^-1, on the fragments' own covariances; the cameras'
    errors are not in it. NaN where the seen views do not determine the segment.
    """
    weight = seen.astype(matrices_px.dtype)
    fragments = jnp.where(seen[:, None, None], fragments_px, 0.0)
    identity = jnp.eye(4, dtype=matrices_px.dtype)
    covariance = jnp.where(seen[:, None, None], covariance_px2, identity)
    information = weight[:, None, None] * jax.vmap(inverse_positive_definite)(covariance)

    def residual(ends: Float[ArrayLike, "6"]) -> Float[ArrayLike, "v 4"]:
        homogeneous = jnp.concatenate([ends.reshape(2, 3), jnp.ones((2, 1))], axis=1)
        image = jnp.einsum("vij,ej->vei", matrices_px, homogeneous)
        return (image[..., :2] / image[..., 2:] - fragments).reshape(-1, 4)

    def normal_equations(
        ends: Float[ArrayLike, "6"],
    ) -> tuple[Float[ArrayLike, "6 6"], Float[ArrayLike, "6"], Float[ArrayLike, ""]]:
        error, jacobian = residual(ends), jax.jacfwd(residual)(ends)
        weighted = jnp.einsum("vij,vjk->vik", information, jacobian)
        hessian = jnp.einsum("vij,vik->jk", jacobian, weighted)
        gradient = jnp.einsum("vij,vi->j", weighted, error)
        return hessian, gradient, jnp.einsum("vi,vij,vj->", error, information, error)

    def step(_: ArrayLike, ends: Float[ArrayLike, "6"]) -> Float[ArrayLike, "6"]:
        hessian, gradient, _chi_square = normal_equations(ends)
        return ends - solve_positive_definite(hessian, gradient)

    start = jax.vmap(triangulate_point, in_axes=(None, 1, None))(matrices_px, fragments, weight)
    ends = jax.lax.fori_loop(0, GAUSS_NEWTON_STEPS, step, start.reshape(6))
    hessian, _, chi_square = normal_equations(ends)
    return Segment3D(ends.reshape(2, 3), inverse_positive_definite(hessian), chi_square)
