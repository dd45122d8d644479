"""Maximum-likelihood 3-D segment from its fragments in two or more views, with covariance.

The two ends minimise the Mahalanobis distance of their images from the ends of the fragments. The
covariance of fragments is large along the segment. So the views determine the line together, and
hardly constrain the positions of the ends along it.
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

# Convergence is quadratic: after three steps the error is at most a millionth of a standard
# deviation.
GAUSS_NEWTON_STEPS = 3


class Segment3D(NamedTuple):
    """A 3-D segment fitted to fragments, with its covariance.

    Attributes
    ----------
    ends_mm : (2, 3)
        Two ends in the world frame.
    covariance_mm2 : (6, 6)
        Covariance of both ends.
    chi_square : ()
        Squared residuals of the fragments' ends, weighted by their covariance.
    """

    ends_mm: Float[ArrayLike, "2 3"]
    covariance_mm2: Float[ArrayLike, "6 6"]
    chi_square: Float[ArrayLike, ""]


class _Iterate(NamedTuple):
    """Result of one Gauss-Newton iteration for the two ends of a 3-D segment.

    Covariance and chi-square belong to the ends before the step; `next_mm` are the ends after it.
    """

    covariance_mm2: Float[ArrayLike, "6 6"]
    chi_square: Float[ArrayLike, ""]
    next_mm: Float[ArrayLike, "2 3"]


def triangulate_point(
    matrices_px: Float[ArrayLike, "v 3 4"],
    uv_px: Float[ArrayLike, "v 2"],
    weight: Float[ArrayLike, "v"],
) -> Float[ArrayLike, "3"]:
    """Return the weighted least-squares point nearest to one viewing ray in each view.

    Parameters
    ----------
    matrices_px : (v, 3, 4)
        Projection matrices of the views.
    uv_px : (v, 2)
        Undistorted pixel of the point in each view.
    weight : (v,)
        Weight of each view's ray; 0 excludes a view.

    Returns
    -------
    (3,)
        Point in the world frame, mm.
    """

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
    visible: Bool[ArrayLike, "v"],
) -> Segment3D:
    """Return the maximum-likelihood 3-D segment of corresponding fragments.

    Parameters
    ----------
    matrices_px : (v, 3, 4)
        Projection matrices of the views.
    fragments_px : (v, 2, 2)
        Corresponding ends in each view, undistorted pixels.
    covariance_px2 : (v, 4, 4)
        Covariance of the ends of each fragment.
    visible : (v,)
        True for views that show the segment. The fragments of other views are ignored.

    Returns
    -------
    Segment3D
        Its covariance (J^T W J)^-1 contains the errors of the fragments, but not those of the
        cameras. NaN if the visible views do not determine the segment.
    """
    weight = visible.astype(matrices_px.dtype)
    fragments = jnp.where(visible[:, None, None], fragments_px, 0.0)
    identity = jnp.eye(4, dtype=matrices_px.dtype)
    covariance = jnp.where(visible[:, None, None], covariance_px2, identity)
    information = weight[:, None, None] * jax.vmap(inverse_positive_definite)(covariance)

    def fit_ends(ends: Float[ArrayLike, "2 3"]) -> _Iterate:
        image = project_with_jacobian(matrices_px, ends[None])
        error = (image.uv_px - fragments).reshape(-1, 4)
        # Derivative of both pixel coordinates of an end by its three coordinates: (v, e, 2, 3).
        slope = image.by_point
        blocks = information.reshape(-1, 2, 2, 2, 2)
        # Axes: view, end, image coordinate, end, image coordinate, space coordinate.
        weighted = (blocks[..., None] * slope[:, None, None]).sum(4)
        hessian = (slope[:, :, :, :, None, None] * weighted[:, :, :, None]).sum((0, 2))
        of_error = (information * error[:, None, :]).sum(-1)
        gradient = (slope * of_error.reshape(-1, 2, 2)[..., None]).sum((0, 2))
        covariance = inverse_positive_definite(hessian.reshape(6, 6))
        step = (covariance * gradient.reshape(1, 6)).sum(-1).reshape(2, 3)
        return _Iterate(covariance, (error * of_error).sum(), ends - step)

    start = jax.vmap(triangulate_point, in_axes=(None, 1, None))(matrices_px, fragments, weight)
    initial = _Iterate(jnp.zeros((6, 6)), jnp.zeros(()), start)
    solution = jax.lax.fori_loop(
        0, GAUSS_NEWTON_STEPS, lambda _, fit: fit_ends(fit.next_mm), initial
    )
    # Covariance and chi-square belong to the ends before the last step, which is negligible.
    return Segment3D(solution.next_mm, solution.covariance_mm2, solution.chi_square)
