"""Refined cameras and lines as a differentiable function of the observations.

At the minimum the gradient of the cost is zero, whatever path led there; the implicit function
theorem turns that into derivatives by fragments, by the sheet's estimate and by anything they
were computed from, without differentiating the minimisation. The linear systems with the true
Hessian are solved by conjugate gradients, preconditioned with the reduced system: no matrix
over all unknowns is formed.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.bundle.levenberg_marquardt import joint_cost, joint_system, minimise
from trinoc.calib.bundle.line_retraction import moved_anchors
from trinoc.calib.bundle.pose_prior import PosePrior
from trinoc.calib.bundle.schur import FragmentTable, ReducedSystem
from trinoc.calib.model import CameraState
from trinoc.numerics import ArrayLike, ScalarLike

# Gauss-Newton steps that take the minimum, known to a share of a sigma, to rounding error.
POLISHING_STEPS = 6
CONJUGATE_GRADIENT_TOLERANCE = 1e-10


class Offsets(NamedTuple):
    """Steps of all cameras (v, p) and of all lines (t, 4) in their charts."""

    cameras: Float[ArrayLike, "v p"]
    lines: Float[ArrayLike, "t 4"]


def refined(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    prior: PosePrior,
    scale: ScalarLike,
) -> tuple[CameraState, Float[ArrayLike, "t 2 3"]]:
    """Cameras and lines of least cost, differentiable by `tracks` and `prior`.

    `prior` must hold the gauge, as a sheet does. Derivatives by the starting values are zero:
    the minimum does not depend on them. For use under `jit` and `grad`, in double precision.
    """
    fixed = jax.lax.stop_gradient((tracks, prior))
    state = minimise(*jax.lax.stop_gradient((cameras, anchors_mm)), *fixed, jnp.asarray(scale))

    def polish(
        _: ArrayLike, point: tuple[CameraState, Float[ArrayLike, "t 2 3"]]
    ) -> tuple[CameraState, Float[ArrayLike, "t 2 3"]]:
        here = _Minimum(*point, joint_system(*point, *fixed, scale, 0.0))
        return _moved(*point, here.newton(here.gradient(*fixed, scale)))

    start = state.cameras, state.anchors_mm
    cameras, anchors = jax.lax.fori_loop(0, POLISHING_STEPS, polish, start)
    system = joint_system(cameras, anchors, *fixed, scale, 0.0)
    minimum = jax.lax.stop_gradient(_Minimum(cameras, anchors, system))

    def gradient(offsets: Offsets) -> Offsets:
        return jax.grad(minimum.cost)(offsets, tracks, prior, scale)

    zero = Offsets(jnp.zeros(prior.values.shape), jnp.zeros((len(anchors), 4)))
    offsets = jax.lax.custom_root(
        gradient,
        zero,
        lambda _gradient, start: start,
        lambda hessian, right: jax.lax.custom_linear_solve(
            hessian, right, minimum.solve, symmetric=True
        ),
    )
    return _moved(minimum.cameras, minimum.anchors_mm, offsets)


class _Minimum(NamedTuple):
    """A point, in whose charts offsets are counted, and its reduced system."""

    cameras: CameraState
    anchors_mm: Float[ArrayLike, "t 2 3"]
    system: ReducedSystem

    def cost(
        self, offsets: Offsets, tracks: FragmentTable, prior: PosePrior, scale: ScalarLike
    ) -> Float[ArrayLike, ""]:
        """Half the joint cost after a move: its Hessian is the system's information."""
        cameras, anchors = _moved(self.cameras, self.anchors_mm, offsets)
        return 0.5 * joint_cost(cameras, anchors, tracks, prior, scale)

    def gradient(self, tracks: FragmentTable, prior: PosePrior, scale: ScalarLike) -> Offsets:
        zero = Offsets(jnp.zeros(prior.values.shape), jnp.zeros((len(self.anchors_mm), 4)))
        return jax.grad(self.cost)(zero, tracks, prior, scale)

    def newton(self, gradient: Offsets) -> Offsets:
        """The Gauss-Newton step against a gradient, by way of the reduced system."""
        return jax.tree.map(jnp.negative, self.precondition(gradient))

    def precondition(self, right: Offsets) -> Offsets:
        """Solve with the Gauss-Newton matrix of all unknowns."""
        follow = self.system.line_by_cameras
        reduced = right.cameras.reshape(-1) + jnp.einsum("tik,ti->k", follow, right.lines)
        step = jnp.linalg.solve(self.system.information, reduced)
        lines = jnp.einsum("tij,tj->ti", self.system.line_covariance, right.lines)
        lines = lines + jnp.einsum("tik,k->ti", follow, step)
        return Offsets(step.reshape(right.cameras.shape), lines)

    def solve(self, hessian: object, right: Offsets) -> Offsets:
        """Solve with the true Hessian by preconditioned conjugate gradients."""
        solution, _ = jax.scipy.sparse.linalg.cg(
            hessian, right, tol=CONJUGATE_GRADIENT_TOLERANCE, M=self.precondition
        )
        return solution


def _moved(
    cameras: CameraState, anchors_mm: Float[ArrayLike, "t 2 3"], offsets: Offsets
) -> tuple[CameraState, Float[ArrayLike, "t 2 3"]]:
    moved = jax.vmap(CameraState.moved)(cameras, offsets.cameras)
    return moved, jax.vmap(moved_anchors)(anchors_mm, offsets.lines)
