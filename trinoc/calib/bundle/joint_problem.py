"""Cameras and lines as one least-squares problem whose normal equations form a block arrow.

Let A and B be the Jacobians of one track with respect to the cameras and to the four coordinates of
its line. The normal equations are

    [ A^T A   A^T B ] [ camera step ]     [ A^T r ]
    [ B^T A   B^T B ] [ line step   ] = - [ B^T r ]

and their sum over all tracks is a block arrow: the cameras are shared by all lines, and each line
is a block. 10,000 lines and three cameras have about 40,000 unknowns, of which 18 remain after the
elimination of the lines.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from trinoc.calib.bundle.camera import CameraState
from trinoc.calib.bundle.factors import (
    PosePrior,
    line_from_two_views,
    line_residual,
    retract_line,
)
from trinoc.calib.problem.solver import AbstractSeparableProblem, ArrowEquations, Costs
from trinoc.numerics.block_arrow import BlockArrow
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.robust_loss import AbstractRobustLoss
from trinoc.numerics.small_matrices import log_determinant_positive_definite


class FragmentTable(NamedTuple):
    """Fragments (parts of detected segments) of t tracks in v views, padded.

    Attributes
    ----------
    fragments_px : (t, v, 2, 2) ends of each fragment, in pixels of the original image. Unobserved
        fragments contain arbitrary finite numbers.
    covariance_px2 : (t, v, 4, 4) covariance of these ends.
    is_observed : (t, v) whether each track is observed in each view; all False for padding.
    """

    fragments_px: Float[ArrayLike, "t v 2 2"]
    covariance_px2: Float[ArrayLike, "t v 4 4"]
    is_observed: Bool[ArrayLike, "t v"]

    def in_three_views(self) -> "FragmentTable":
        """Table in which tracks with fewer than three views are unobserved. Such tracks fit any
        cameras.
        """
        enough = jnp.sum(self.is_observed, axis=1) >= 3
        return self._replace(is_observed=self.is_observed & enough[:, None])


class CamerasAndLines(NamedTuple):
    """Unknowns of a refinement.

    Attributes
    ----------
    cameras : v cameras, stacked.
    anchors_mm : (t, 2, 3) two points on each of t lines.
    """

    cameras: CameraState
    anchors_mm: Float[ArrayLike, "t 2 3"]

    def retract(
        self, head: Float[ArrayLike, "k"], blocks: Float[ArrayLike, "t 4"]
    ) -> "CamerasAndLines":
        """State after small changes of all cameras (`head`) and all lines (`blocks`) in local
        coordinates.
        """
        views = self.cameras.working_distance_mm.shape[0]
        cameras = jax.vmap(CameraState.retract)(self.cameras, head.reshape(views, -1))
        return CamerasAndLines(cameras, jax.vmap(retract_line)(self.anchors_mm, blocks))


class JointProblem(AbstractSeparableProblem[CamerasAndLines]):
    """Least-squares problem of cameras and lines, with a robust loss and the calibration prior.

    Attributes
    ----------
    tracks : observed tracks, of three or more views. In two views a line has as many unknowns as
        distances and does not constrain the cameras.
    prior : calibration prior of the cameras.
    loss : robust loss of the distance between fragment and line.
    """

    # Lines start near their minimum.
    first_damping: ClassVar[float] = 1e-4

    tracks: FragmentTable
    prior: PosePrior
    loss: AbstractRobustLoss

    def costs(self, state: CamerasAndLines) -> Costs:
        """Cost in parts: chi-square of the prior, and robust cost of each track."""
        of_tracks = jnp.sum(self.loss.rho(squared_distances(state, self.tracks)), axis=1)
        return Costs(self.prior.cost(state.cameras), of_tracks)

    def equations(self, state: CamerasAndLines) -> ArrowEquations:
        """Gauss-Newton equations of all tracks, weighted by the robust loss, and of the prior.

        Padding, and lines that their views do not determine, are omitted: these lines do not change
        and have no effect on the cameras.
        """
        residual, by_camera, by_line = jax.vmap(_linearise_track, (None, 0, 0))(
            state.cameras, state.anchors_mm, self.tracks
        )
        squared = jnp.sum(jnp.square(residual), axis=-1)
        weight = self.loss.weight(squared)
        blocks = jnp.einsum("tv,tvri,tvrj->tij", weight, by_line, by_line)
        determined = jnp.isfinite(jax.vmap(log_determinant_positive_definite)(blocks))
        blocks = jnp.where(determined[:, None, None], blocks, 0.0)
        weight = jnp.where(determined[:, None], weight, 0.0)[..., None, None]
        of_camera, of_line = weight * by_camera, weight * by_line
        tracks, views, _, size = by_camera.shape
        view = jnp.arange(views)
        head = jnp.zeros((views, size, views, size))
        head = head.at[view, :, view, :].set(jnp.einsum("tvrp,tvrq->vpq", of_camera, by_camera))
        prior_equations = self.prior.normal_equations(state.cameras)
        return ArrowEquations(
            jnp.sum(self.loss.rho(squared)) + self.prior.cost(state.cameras),
            BlockArrow(
                head.reshape(views * size, -1) + prior_equations.information,
                jnp.einsum("tvrp,tvri->tvpi", by_camera, of_line).reshape(tracks, -1, 4),
                blocks,
            ),
            (
                jnp.einsum("tvrp,tvr->vp", of_camera, residual).reshape(-1)
                + prior_equations.gradient,
                jnp.einsum("tvri,tvr->ti", of_line, residual),
            ),
        )

    def line_information(self, state: CamerasAndLines) -> Float[ArrayLike, "k k"]:
        """Gauss-Newton information, (k, k), of all tracks about the cameras, with the lines
        eliminated.

        It is computed by projecting the Jacobian onto the complement of each line's columns. The
        equivalent Schur complement is a difference of large numbers. Its rounding errors would look
        like information about undetermined directions.
        """
        residual, by_camera, by_line = jax.vmap(_linearise_track, (None, 0, 0))(
            state.cameras, state.anchors_mm, self.tracks
        )
        root = self.loss.root_weight(jnp.sum(jnp.square(residual), axis=-1))[..., None, None]
        tracks, views = residual.shape[:2]
        camera_rows = jnp.einsum("tvrp,vw->tvrwp", root * by_camera, jnp.eye(views))
        rows = jnp.concatenate(
            [
                (root * by_line).reshape(tracks, 2 * views, 4),
                camera_rows.reshape(tracks, 2 * views, -1),
            ],
            axis=2,
        )
        for _ in range(4):
            line_row, rows = rows[..., :1], rows[..., 1:]
            length = jnp.sqrt(jnp.sum(line_row**2, axis=1, keepdims=True))
            unit = line_row / jnp.where(length > 0, length, 1.0)
            rows = rows - unit * jnp.sum(unit * rows, axis=1, keepdims=True)
        return jnp.einsum("tri,trj->ij", rows, rows)

    def retract(
        self, state: CamerasAndLines, head: Float[ArrayLike, "k"], blocks: Float[ArrayLike, "t 4"]
    ) -> CamerasAndLines:
        """State after small changes of all cameras (`head`) and all lines (`blocks`)."""
        return state.retract(head, blocks)


def squared_distances(state: CamerasAndLines, tracks: FragmentTable) -> Float[ArrayLike, "t v"]:
    """Squared distance, (t, v), of each observed segment's ends from the image of its line, in
    sigmas.

    It is the squared Mahalanobis distance of both ends together; 0 if the track is not observed in
    the view.
    """
    by_view = jax.vmap(line_residual, (0, None, 0, 0))
    residual = jax.vmap(by_view, (None, 0, 0, 0))(*state, *tracks[:2])
    return jnp.where(tracks.is_observed, jnp.sum(jnp.square(residual), axis=-1), 0.0)


def with_lines_of_two_views(state: CamerasAndLines, tracks: FragmentTable) -> CamerasAndLines:
    """State in which lines with two views are computed from the cameras, by intersecting two
    planes.
    """
    lines_from_views = jax.vmap(line_from_two_views, (None, 0, 0, 0))
    return state._replace(
        anchors_mm=lines_from_views(*state, tracks.fragments_px, tracks.is_observed)
    )


def _linearise_track(
    cameras: CameraState, anchors_mm: Float[ArrayLike, "2 3"], track: FragmentTable
) -> tuple[Float[ArrayLike, "v 2"], Float[ArrayLike, "v 2 p"], Float[ArrayLike, "v 2 4"]]:
    """Whitened residuals of one track, (v, 2), and their derivatives.

    The derivatives are those with respect to the observing camera, (v, 2, p), and to the line, (v,
    2, 4), in local coordinates.
    """

    def one_view(
        camera: CameraState,
        fragment_px: ArrayLike,
        covariance_px2: ArrayLike,
        is_observed: ArrayLike,
    ) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        def residual(step: ArrayLike, offsets: ArrayLike) -> tuple[ArrayLike, ArrayLike]:
            line = retract_line(anchors_mm, offsets)
            value = line_residual(camera.retract(step), line, fragment_px, covariance_px2)
            return value, value

        at_rest = jnp.zeros(len(camera.names)), jnp.zeros(4)
        (by_camera, by_line), value = jax.jacfwd(residual, argnums=(0, 1), has_aux=True)(*at_rest)
        return jax.tree.map(
            lambda leaf: jnp.where(is_observed, leaf, 0.0), (value, by_camera, by_line)
        )

    return jax.vmap(one_view)(cameras, *track)
