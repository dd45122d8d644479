"""3-D segments with errors end to end: what is each segment's own, and what all share.

For known cameras a segment is the maximum-likelihood pair of ends of its fragments
(`geometry.triangulation`), with its own covariance H^-1. By the implicit function theorem the
ends follow the cameras as dX = -H^-1 (J_X^T W J_c) dc, so that the covariance of several
segments is block-diagonal in their own parts plus A S A^T with S the covariance of the
cameras' parameters: the part that does not average out over segments.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from trinoc.calib.model import CameraState
from trinoc.geometry import project_by_matrix, triangulate_segment
from trinoc.numerics import ArrayLike, inverse_positive_definite


def segment_and_errors(
    cameras: CameraState,
    fragments_px: Float[ArrayLike, "v 2 2"],
    covariance_px2: Float[ArrayLike, "v 4 4"],
    seen: Bool[ArrayLike, "v"],
) -> tuple[Float[ArrayLike, "2 3"], Float[ArrayLike, "6 6"], Float[ArrayLike, "6 k"]]:
    """Ends (mm), own covariance (mm^2), and Jacobian of the ends by all cameras' steps."""
    fragments_px = jnp.where(seen[:, None, None], fragments_px, 0.0)
    identity = jnp.eye(4, dtype=covariance_px2.dtype)
    covariance_px2 = jnp.where(seen[:, None, None], covariance_px2, identity[None])
    undistort = jax.vmap(lambda camera, ends: jax.vmap(camera.undistorted)(ends))
    matrices = jax.vmap(lambda camera: camera.matrix_px)(cameras)
    segment = triangulate_segment(matrices, undistort(cameras, fragments_px), covariance_px2, seen)

    def one_view(
        camera: CameraState, fragment_px: ArrayLike, covariance: ArrayLike, seen_here: ArrayLike
    ) -> ArrayLike:
        def residual(ends: ArrayLike, step: ArrayLike) -> ArrayLike:
            stepped = camera.retract(step)
            image = jax.vmap(project_by_matrix, in_axes=(None, 0))(stepped.matrix_px, ends)
            observed = jax.vmap(stepped.undistorted)(fragment_px)
            return (image - observed).reshape(4)

        at_rest = jnp.zeros(len(camera.names))
        by_ends, by_step = jax.jacfwd(residual, argnums=(0, 1))(segment.ends_mm, at_rest)
        information = jnp.where(seen_here, inverse_positive_definite(covariance), 0.0)
        return by_ends.reshape(4, 6).T @ information @ by_step

    coupling = jax.vmap(one_view)(cameras, fragments_px, covariance_px2, seen)
    follow = -jnp.einsum("ij,vjp->ivp", segment.covariance_mm2, coupling)
    return segment.ends_mm, segment.covariance_mm2, follow.reshape(6, -1)
