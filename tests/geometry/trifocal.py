"""Three views: the trifocal tensor and the transfer of lines.

Source: Hartley and Zisserman, chapter 15 and equation 17.12.
"""

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike


def normalised_line(line: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3"]:
    """The same line, scaled to a unit normal."""
    return line / jnp.hypot(line[0], line[1])


def trifocal_tensor(
    matrix_a_px: Float[ArrayLike, "3 4"],
    matrix_b_px: Float[ArrayLike, "3 4"],
    matrix_c_px: Float[ArrayLike, "3 4"],
) -> Float[ArrayLike, "3 3 3"]:
    """Trifocal tensor T: l_a[i] = sum_jk l_b[j] l_c[k] T[i, j, k] up to scale.

    T[i, j, k] = (-1)^i det of P_a without row i, row j of P_b, row k of P_c.
    """
    slices = []
    for i in range(3):
        rest = jnp.stack([matrix_a_px[r] for r in range(3) if r != i])
        dual = _two_row_minors(rest)
        slices.append((-1) ** i * matrix_b_px @ dual @ matrix_c_px.T)
    return jnp.stack(slices)


def transfer_line(
    tensor: Float[ArrayLike, "3 3 3"],
    line_b: Float[ArrayLike, "3"],
    line_c: Float[ArrayLike, "3"],
) -> Float[ArrayLike, "3"]:
    """Line in view a, with unit normal, that is predicted by lines of views b and c.

    NaN where both are epipolar lines of one plane, which leave the line in space free.
    """
    return normalised_line(jnp.einsum("j,k,ijk->i", line_b, line_c, tensor))


def _two_row_minors(rows: Float[ArrayLike, "2 4"]) -> Float[ArrayLike, "4 4"]:
    """Antisymmetric D with x^T D y = det [rows; x; y]: the dual Pluecker matrix of two planes."""
    p, q = rows[0], rows[1]
    pairs = jnp.outer(p, q) - jnp.outer(q, p)
    zero = jnp.zeros_like(pairs[0, 0])
    return jnp.stack(
        [
            jnp.stack([zero, pairs[2, 3], pairs[3, 1], pairs[1, 2]]),
            jnp.stack([pairs[3, 2], zero, pairs[0, 3], pairs[2, 0]]),
            jnp.stack([pairs[1, 3], pairs[3, 0], zero, pairs[0, 1]]),
            jnp.stack([pairs[2, 1], pairs[0, 2], pairs[1, 0], zero]),
        ]
    )
