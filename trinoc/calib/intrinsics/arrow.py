"""Normal equations of a lens and many poses, solved by eliminating the poses.

Pictures share the lens and nothing else, so J^T J is an arrow: the lens's block, one small
block for each pose, and what couples each pose to the lens. Source: Triggs et al., "Bundle
adjustment: a modern synthesis", section 6.1 (2000).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import lineax as lx
from jaxtyping import Array, Float, PyTree

from trinoc.numerics import ArrayLike


class Arrow(NamedTuple):
    """A symmetric matrix with the unknowns (lens, motion of each picture).

    Fields
    ------
    lens : (q, q) block of the lens.
    coupling : (k, q, 6) between the lens and each picture's motion.
    motion : (k, 6, 6) block of each motion.
    """

    lens: Float[ArrayLike, "q q"]
    coupling: Float[ArrayLike, "k q 6"]
    motion: Float[ArrayLike, "k 6 6"]


class ArrowCholesky(lx.AbstractLinearSolver[tuple[Arrow, Array, Array, Array]]):
    """Solves positive definite arrows over the unknowns (lens (q,), motions (k, 6)).

    The entries are read off by applying the operator to q + 6 vectors, however many pictures
    there are: motions of different pictures do not mix.
    """

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> Any:
        """Read the arrow and factor it."""
        lens_unknowns, motion_unknowns = operator.in_structure()
        size, (count, width) = lens_unknowns.shape[0], motion_unknowns.shape
        dtype = lens_unknowns.dtype

        def lens_column(unit: Float[Array, "q"]) -> PyTree:
            return operator.mv((unit, jnp.zeros((count, width), dtype)))

        def motion_columns(unit: Float[Array, "6"]) -> PyTree:
            motions = jnp.broadcast_to(unit[None], (count, width))
            return operator.mv((jnp.zeros(size, dtype), motions))[1]

        lens, coupling = jax.vmap(lens_column)(jnp.eye(size, dtype=dtype))
        motion = jax.vmap(motion_columns)(jnp.eye(width, dtype=dtype))
        coupling, motion = jnp.swapaxes(coupling, 0, 1), jnp.moveaxis(motion, 0, 2)
        factor = jnp.linalg.cholesky(motion)
        eliminated = jax.vmap(_solve)(factor, jnp.swapaxes(coupling, 1, 2))
        reduced = lens - jnp.einsum("kqi,kir->qr", coupling, eliminated)
        return Arrow(lens, coupling, motion), factor, eliminated, jnp.linalg.cholesky(reduced)

    def compute(
        self, state: Any, vector: PyTree[Array], options: dict[str, Any]
    ) -> tuple[PyTree[Array], lx.RESULTS, dict[str, Any]]:
        """The solution for one right-hand side."""
        _, factor, eliminated, reduced_factor = state
        lens_side, motion_side = vector
        reduced_side = lens_side - jnp.einsum("kiq,ki->q", eliminated, motion_side)
        lens = _solve(reduced_factor, reduced_side)
        motions = jax.vmap(_solve)(factor, motion_side)
        motions = motions - jnp.einsum("kiq,q->ki", eliminated, lens)
        return (lens, motions), lx.RESULTS.successful, {}

    def transpose(self, state: Any, options: dict[str, Any]) -> Any:
        """The matrix is symmetric."""
        return state, options

    def conj(self, state: Any, options: dict[str, Any]) -> Any:
        """The matrix is real."""
        return state, options

    def assume_full_rank(self) -> bool:
        """Damping makes it so."""
        return True


def _solve(factor: Float[Array, "n n"], side: Float[Array, "n *m"]) -> Float[Array, "n *m"]:
    return jsl.cho_solve((factor, True), side)
