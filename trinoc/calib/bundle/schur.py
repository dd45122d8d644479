"""Normal equations of cameras and lines, an arrow from which every line can be eliminated.

For one track with Jacobians A_v (by the step of camera v) and B_v (by the four numbers of the
line) the normal equations are

    [ A^T A   A^T B ] [ camera step ]     [ A^T r ]
    [ B^T A   B^T B ] [ line step   ] = - [ B^T r ]

and their sum over tracks is an arrow (`numerics.block_arrow`): a line's own 4x4 block is solved
at once, and the cameras keep the Schur complement A^T A - A^T B (B^T B)^-1 B^T A.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from trinoc.calib.bundle.line_residual import distances_across
from trinoc.calib.bundle.line_retraction import moved_anchors
from trinoc.calib.model import CameraState
from trinoc.numerics import (
    AbstractRobustLoss,
    ArrayLike,
    BlockArrow,
    ScalarLike,
    inverse_positive_definite,
)


class FragmentTable(NamedTuple):
    """Fragments of all tracks, padded: in pixels of the picture, with whitening matrices.

    A padding track is seen nowhere.
    """

    fragments_px: Float[ArrayLike, "t v 2 2"]
    whitening: Float[ArrayLike, "t v 2 2"]
    seen: Bool[ArrayLike, "t v"]


class TrackBlocks(NamedTuple):
    """What one track adds to the normal equations.

    Fields
    ------
    camera_information : (v, p, p) A_v^T A_v; camera_gradient : (v, p) A_v^T r_v.
    coupling : (v, p, 4) A_v^T B_v.
    line_information : (4, 4); line_gradient : (4,).
    squared : (v,) squared Mahalanobis distance of each fragment, before weighting.
    """

    camera_information: Float[ArrayLike, "*t v p p"]
    camera_gradient: Float[ArrayLike, "*t v p"]
    coupling: Float[ArrayLike, "*t v p 4"]
    line_information: Float[ArrayLike, "*t 4 4"]
    line_gradient: Float[ArrayLike, "*t 4"]
    squared: Float[ArrayLike, "*t v"]


class NormalEquations(NamedTuple):
    """Gauss-Newton's equations of all unknowns: `information` times the step is -`gradient`.

    Fields
    ------
    information : arrow over (all cameras' steps (k,), lines' steps (t, 4)), k = v p.
    gradient : ((k,), (t, 4)).
    """

    information: BlockArrow
    gradient: tuple[Float[ArrayLike, "k"], Float[ArrayLike, "t 4"]]


def fragment_distances(
    camera: CameraState,
    anchors_mm: Float[ArrayLike, "2 3"],
    fragment_px: Float[ArrayLike, "2 2"],
    whitening: Float[ArrayLike, "2 2"],
) -> Float[ArrayLike, "2"]:
    """Distances of a fragment's ends across the projected line, in sigmas."""
    undistorted = jax.vmap(camera.undistorted)(fragment_px)
    return whitening @ distances_across(camera.matrix_px, anchors_mm, undistorted)


def squared_distances(
    cameras: CameraState, anchors_mm: Float[ArrayLike, "t 2 3"], tracks: FragmentTable
) -> Float[ArrayLike, "t v"]:
    """Squared Mahalanobis distance of every fragment; 0 where not seen."""
    by_view = jax.vmap(fragment_distances, (0, None, 0, 0))
    distance = jax.vmap(by_view, (None, 0, 0, 0))(
        cameras, anchors_mm, tracks.fragments_px, tracks.whitening
    )
    return jnp.where(tracks.seen, jnp.sum(jnp.square(distance), axis=-1), 0.0)


def robust_costs(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    loss: AbstractRobustLoss,
) -> Float[ArrayLike, "t"]:
    """Sum of the loss over the fragments of each track."""
    return jnp.sum(loss.rho(squared_distances(cameras, anchors_mm, tracks)), axis=1)


def track_blocks(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "2 3"],
    tracks: FragmentTable,
    loss: AbstractRobustLoss,
) -> TrackBlocks:
    """The blocks of one track (`tracks` without its leading axis)."""

    def one_view(
        camera: CameraState, fragment_px: ArrayLike, whitening: ArrayLike, seen: ArrayLike
    ) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        def distances(step: ArrayLike, offsets: ArrayLike) -> ArrayLike:
            anchors = moved_anchors(anchors_mm, offsets)
            return fragment_distances(camera.retract(step), anchors, fragment_px, whitening)

        at_rest = jnp.zeros(len(camera.names)), jnp.zeros(4)
        residual = jnp.where(seen, distances(*at_rest), 0.0)
        by_camera, by_line = jax.jacfwd(distances, argnums=(0, 1))(*at_rest)
        return residual, jnp.where(seen, by_camera, 0.0), jnp.where(seen, by_line, 0.0)

    residual, by_camera, by_line = jax.vmap(one_view)(cameras, *tracks)
    squared = jnp.sum(jnp.square(residual), axis=-1)
    weights = loss.weight(squared)
    weighted_camera = weights[:, None, None] * by_camera
    weighted_line = weights[:, None, None] * by_line
    return TrackBlocks(
        jnp.einsum("vrp,vrq->vpq", weighted_camera, by_camera),
        jnp.einsum("vrp,vr->vp", weighted_camera, residual),
        jnp.einsum("vrp,vri->vpi", weighted_camera, by_line),
        jnp.einsum("vri,vrj->ij", weighted_line, by_line),
        jnp.einsum("vri,vr->i", weighted_line, residual),
        squared,
    )


def normal_equations(
    blocks: TrackBlocks, seen: Bool[ArrayLike, "t v"], damping: ScalarLike | Float[ArrayLike, "t"]
) -> NormalEquations:
    """Sum over tracks; `damping`, one for all or one for each line, scales the diagonals of the
    lines' blocks as Levenberg and Marquardt do.

    Two views have as many distances as their line has unknowns, so that eliminating the line
    leaves nothing: such tracks are left out, where only rounding would remain of them. So is a
    line that its views do not determine (or padding): it says nothing and has no step.
    """
    tracks, views, size = blocks.camera_gradient.shape
    count = views * size
    diagonal = jnp.einsum("tii->ti", blocks.line_information)
    damping = jnp.broadcast_to(damping, (tracks,))[:, None, None]
    damped = blocks.line_information + damping * diagonal[:, :, None] * jnp.eye(4)[None]
    inverse = jax.vmap(inverse_positive_definite)(damped)
    speaks = jnp.all(jnp.isfinite(inverse), axis=(1, 2)) & (jnp.sum(seen, axis=1) >= 3)
    weight = speaks.astype(damped.dtype)
    own = jnp.einsum("t,tvpq->vpq", weight, blocks.camera_information)
    view = jnp.arange(views)
    head = jnp.zeros((views, size, views, size)).at[view, :, view, :].set(own)
    return NormalEquations(
        BlockArrow(
            head.reshape(count, count),
            jnp.where(speaks[:, None, None], blocks.coupling.reshape(tracks, count, 4), 0.0),
            jnp.where(speaks[:, None, None], damped, 0.0),
        ),
        (
            jnp.einsum("t,tvp->vp", weight, blocks.camera_gradient).reshape(count),
            jnp.where(speaks[:, None], blocks.line_gradient, 0.0),
        ),
    )
