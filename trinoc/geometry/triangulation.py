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
from trinoc.geometry.projection import project_with_jacobian
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.small_matrices import (
    inverse_3x3,
    inverse_positive_definite,
    solve_positive_definite,
)

# The error is squared in each: after three, a millionth of a standard deviation or less is left.
GAUSS_NEWTON_STEPS = 3


class Segment3D(NamedTuple):
    """Two ends (2, 3) in mm, their covariance (6, 6), and the chi-square of the fit."""

    ends_mm: Float[ArrayLike, "2 3"]
    covariance_mm2: Float[ArrayLike, "6 6"]
    chi_square: Float[ArrayLike, ""]


class _Iterate(NamedTuple):
    """At some ends: the covariance and chi-square there, and the next ends of Gauss-Newton."""

    covariance_mm2: Float[ArrayLike, "6 6"]
    chi_square: Float[ArrayLike, ""]
    next_mm: Float[ArrayLike, "2 3"]


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

    def fit_ends(ends: Float[ArrayLike, "2 3"]) -> _Iterate:
        image = project_with_jacobian(matrices_px, ends[None])
        error = (image.uv_px - fragments).reshape(-1, 4)
        # Of each end's two coordinates by its own three: (v, e, 2, 3).
        slope = image.by_point
        blocks = information.reshape(-1, 2, 2, 2, 2)
        # Axes: view, end, coordinate of the image, end, coordinate, place.
        weighted = (blocks[..., None] * slope[:, None, None]).sum(4)
        hessian = (slope[:, :, :, :, None, None] * weighted[:, :, :, None]).sum((0, 2))
        of_error = (information * error[:, None, :]).sum(-1)
        gradient = (slope * of_error.reshape(-1, 2, 2)[..., None]).sum((0, 2))
        covariance = inverse_positive_definite(hessian.reshape(6, 6))
        step = (covariance * gradient.reshape(1, 6)).sum(-1).reshape(2, 3)
        return _Iterate(covariance, (error * of_error).sum(), ends - step)

    start = jax.vmap(triangulate_point, in_axes=(None, 1, None))(matrices_px, fragments, weight)
    nothing = _Iterate(jnp.zeros((6, 6)), jnp.zeros(()), start)
    found = jax.lax.fori_loop(0, GAUSS_NEWTON_STEPS, lambda _, fit: fit_ends(fit.next_mm), nothing)
    # The covariance and the chi-square are those before the last step, which hardly moves the ends.
    return Segment3D(found.next_mm, found.covariance_mm2, found.chi_square)
