"""Normal equations with an arrow structure: many small groups of unknowns that share a few others.

Images of one camera share its lens; lines of a scene share the cameras. J^T J is an arrow,

    [ head        coupling_1  ...  coupling_k ]
    [ coupling_1^T  block_1                   ]
    [ ...                     ...             ]
    [ coupling_k^T                   block_k  ]

Elimination of the blocks gives the Schur complement of the head, head - sum_j coupling_j block_j^-1
coupling_j^T. Cost and memory are linear in the number of blocks. Source: Triggs et al., "Bundle
adjustment: a modern synthesis", section 6.1 (2000).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import lineax as lx
from jaxtyping import Array, Float, PyTree

from trinoc.numerics.precision import ArrayLike, ScalarLike
from trinoc.numerics.small_matrices import inverse_positive_definite

Unknowns = tuple[Float[ArrayLike, "q"], Float[ArrayLike, "k w"]]


class BlockArrow(lx.AbstractLinearOperator):
    """Symmetric positive semidefinite matrix in block-arrow form.

    The unknowns are a head of q numbers and k blocks of w numbers. Each block is coupled to the
    head, but not to other blocks.

    Attributes
    ----------
    head : (q, q)
        Entries of the head.
    coupling : (k, q, w)
        Entries between the head and each block.
    blocks : (k, w, w)
        Entries of each block.
    """

    head: Float[ArrayLike, "q q"]
    coupling: Float[ArrayLike, "k q w"]
    blocks: Float[ArrayLike, "k w w"]

    @classmethod
    def of_operator(cls, operator: lx.AbstractLinearOperator) -> "BlockArrow":
        """Read the entries of a linear operator that has block-arrow form.

        The operator is applied to only q + w vectors, because the blocks are not coupled.

        Parameters
        ----------
        operator : lineax operator
            Operator on the unknowns (head (q,), blocks (k, w)).

        Raises
        ------
        ValueError
            If the unknowns have another structure.
        """
        structure = operator.in_structure()
        if not isinstance(structure, tuple) or [len(leaf.shape) for leaf in structure] != [1, 2]:
            raise ValueError(
                "An arrow has the unknowns (head (q,), blocks (k, w)), not "
                f"{jax.tree.structure(structure)}. Use a parametrisation with these two parts."
            )
        size, (count, width) = structure[0].shape[0], structure[1].shape
        dtype = structure[0].dtype

        def apply(head: Float[Array, "q"], blocks: Float[Array, "k w"]) -> PyTree:
            return tuple(
                operator.mv(jax.tree.unflatten(jax.tree.structure(structure), (head, blocks)))
            )

        def head_column(unit: Float[Array, "q"]) -> PyTree:
            return apply(unit, jnp.zeros((count, width), dtype))

        def block_columns(unit: Float[Array, "w"]) -> PyTree:
            repeated = jnp.broadcast_to(unit[None], (count, width))
            return apply(jnp.zeros(size, dtype), repeated)[1]

        head, coupling = jax.vmap(head_column)(jnp.eye(size, dtype=dtype))
        blocks = jax.vmap(block_columns)(jnp.eye(width, dtype=dtype))
        return cls(head, jnp.swapaxes(coupling, 0, 1), jnp.moveaxis(blocks, 0, 2))

    def with_damped_blocks(self, damping: ScalarLike | Float[ArrayLike, "k"]) -> "BlockArrow":
        """Copy in which the diagonals of the blocks are multiplied by 1 + damping.

        Parameters
        ----------
        damping : scalar or (k,)
            One number for all blocks, or one per block.
        """
        count, width, _ = self.blocks.shape
        factor = 1 + jnp.broadcast_to(damping, (count,))[:, None, None] * jnp.eye(width)[None]
        return BlockArrow(self.head, self.coupling, self.blocks * factor)

    def mv(self, vector: Unknowns) -> Unknowns:
        """Product of the matrix and a vector.

        Parameters
        ----------
        vector : ((q,), (k, w))
            Values of the head and of the blocks.
        """
        head, blocks = vector
        return (
            self.head @ head + jnp.einsum("kqw,kw->q", self.coupling, blocks),
            jnp.einsum("kqw,q->kw", self.coupling, head)
            + jnp.einsum("kvw,kw->kv", self.blocks, blocks),
        )

    def as_matrix(self) -> Float[Array, "n n"]:
        """Dense matrix (n, n) with n = q + k w; the rows of the head come first."""
        count, size, width = self.coupling.shape
        coupling_matrix = jnp.moveaxis(self.coupling, 1, 0).reshape(size, count * width)
        block_matrix = jsl.block_diag(*self.blocks)
        return jnp.block(
            [[jnp.asarray(self.head), coupling_matrix], [coupling_matrix.T, block_matrix]]
        )

    def transpose(self) -> "BlockArrow":
        """The matrix itself, because it is symmetric."""
        return self

    def in_structure(self) -> PyTree[jax.ShapeDtypeStruct]:
        """Shapes of a vector: (head (q,), blocks (k, w))."""
        count, size, width = self.coupling.shape
        dtype = self.coupling.dtype
        return jax.ShapeDtypeStruct((size,), dtype), jax.ShapeDtypeStruct((count, width), dtype)

    def out_structure(self) -> PyTree[jax.ShapeDtypeStruct]:
        """Shapes of a product: (head (q,), blocks (k, w))."""
        return self.in_structure()


class Elimination(NamedTuple):
    """Schur complement of a block-arrow matrix, with the terms for back substitution.

    A block that is not positive definite is ignored: its unknowns become zero.

    Attributes
    ----------
    inverse : (k, w, w)
        Inverse of each block; zeros if the inverse does not exist.
    blocks_by_head : (k, w, q)
        Derivative of each block's unknowns with respect to the unknowns of the head.
    reduced : (q, q)
        Matrix of the head after elimination of the blocks.
    """

    inverse: Float[ArrayLike, "k w w"]
    blocks_by_head: Float[ArrayLike, "k w q"]
    reduced: Float[ArrayLike, "q q"]

    def reduced_side(self, side: Unknowns) -> Float[ArrayLike, "q"]:
        """Right-hand side of the head's equations after elimination of the blocks, (q,).

        Parameters
        ----------
        side : ((q,), (k, w))
            Right-hand side of the whole system.
        """
        return side[0] + jnp.einsum("kwq,kw->q", self.blocks_by_head, side[1])

    def blocks_of(
        self, head: Float[ArrayLike, "q"], side: Float[ArrayLike, "k w"]
    ) -> Float[ArrayLike, "k w"]:
        """Unknowns of the blocks, (k, w), by back substitution.

        Parameters
        ----------
        head : (q,)
            Solution for the head.
        side : (k, w)
            Right-hand side of the blocks.
        """
        uncoupled = jnp.einsum("kvw,kw->kv", self.inverse, side)
        return uncoupled + jnp.einsum("kwq,q->kw", self.blocks_by_head, head)


def eliminate(arrow: BlockArrow) -> Elimination:
    """Eliminate the blocks of a block-arrow matrix by the Schur complement.

    Parameters
    ----------
    arrow : BlockArrow
        The matrix.
    """
    inverse = jax.vmap(inverse_positive_definite)(arrow.blocks)
    determined = jnp.all(jnp.isfinite(inverse), axis=(1, 2))
    inverse = jnp.where(determined[:, None, None], inverse, 0.0)
    blocks_by_head = -jnp.einsum("kvw,kqw->kvq", inverse, arrow.coupling)
    reduced = arrow.head + jnp.einsum("kqw,kwr->qr", arrow.coupling, blocks_by_head)
    return Elimination(inverse, blocks_by_head, reduced)


class FactoredArrow(NamedTuple):
    """Block-arrow matrix that is prepared for the solution of linear equations.

    Attributes
    ----------
    elimination : Elimination
        Elimination of the blocks.
    scale : (q,)
        Square root of the diagonal of the reduced matrix.
    factors : ((q, q), (q,))
        LU factors of the reduced matrix, after scaling to a unit diagonal.
    """

    elimination: Elimination
    scale: Float[ArrayLike, "q"]
    factors: tuple[Float[Array, "q q"], Array]


class BlockArrowSolver(lx.AbstractLinearSolver[FactoredArrow]):
    """Linear solver for block-arrow matrices, with Levenberg-Marquardt damping.

    The solver eliminates the blocks.

    Attributes
    ----------
    damping : scalar
        Number added to the diagonal of the reduced matrix, after this matrix is scaled to a unit
        diagonal. Poorly determined unknowns of the head then move less.
    block_damping : scalar or (k,)
        Fraction of the diagonals of the blocks that is added to them.
    """

    damping: ScalarLike = 0.0
    block_damping: ScalarLike | Float[ArrayLike, "k"] = 0.0

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> FactoredArrow:
        """Prepare a matrix: eliminate its blocks, and factor the reduced matrix."""
        arrow = operator if isinstance(operator, BlockArrow) else BlockArrow.of_operator(operator)
        elimination = eliminate(arrow.with_damped_blocks(self.block_damping))
        # The floor avoids a division by zero in directions without information.
        scale = jnp.sqrt(jnp.maximum(jnp.diag(elimination.reduced), 1e-300))
        scaled = elimination.reduced / scale[:, None] / scale[None, :]
        damped = scaled + self.damping * jnp.eye(len(scale), dtype=scale.dtype)
        return FactoredArrow(elimination, scale, jsl.lu_factor(damped))

    def compute(
        self, state: FactoredArrow, vector: PyTree[Array], options: dict[str, Any]
    ) -> tuple[PyTree[Array], lx.RESULTS, dict[str, Any]]:
        """Solve the equations of a prepared matrix for one right-hand side.

        Parameters
        ----------
        state : FactoredArrow
            Result of `init`.
        vector : ((q,), (k, w))
            Right-hand side of the head and of the blocks.
        options : dict
            Not used.

        Returns
        -------
        Solution (head, blocks), the status, and an empty dict.
        """
        elimination, scale, factors = state
        head = jsl.lu_solve(factors, elimination.reduced_side(vector) / scale) / scale
        blocks = elimination.blocks_of(head, vector[1])
        # Named pairs of (head, blocks) keep their names.
        solution = jax.tree.unflatten(jax.tree.structure(vector), (head, blocks))
        return solution, lx.RESULTS.successful, {}

    def transpose(
        self, state: FactoredArrow, options: dict[str, Any]
    ) -> tuple[FactoredArrow, dict[str, Any]]:
        """Prepared transpose of the matrix: the same, because the matrix is symmetric."""
        return state, options

    def conj(
        self, state: FactoredArrow, options: dict[str, Any]
    ) -> tuple[FactoredArrow, dict[str, Any]]:
        """Prepared complex conjugate of the matrix: the same, because the matrix is real."""
        return state, options

    def assume_full_rank(self) -> bool:
        """True, because the solver fixes or damps undetermined unknowns."""
        return True


# lineax asks for properties of an operator by functions that dispatch on its type.
for _yes in (lx.is_symmetric, lx.is_positive_semidefinite):
    _yes.register(BlockArrow)(lambda operator: True)
for _no in (
    lx.is_diagonal,
    lx.is_tridiagonal,
    lx.is_lower_triangular,
    lx.is_upper_triangular,
    lx.has_unit_diagonal,
    lx.is_negative_semidefinite,
):
    _no.register(BlockArrow)(lambda operator: False)
for _itself in (lx.linearise, lx.materialise, lx.conj):
    _itself.register(BlockArrow)(lambda operator: operator)
