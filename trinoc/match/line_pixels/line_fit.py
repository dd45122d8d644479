"""The four parameters of a line in space from what all its views say of its images."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.numerics import ArrayLike, in_blocks, kept_jit, solve_positive_definite

_LINES_AT_ONCE = 256
_STEPS = 4
_LEAST_INFORMATION = 1e-12


class LineFit(NamedTuple):
    """Lines, or the normal equations of one: then `move_mm` is the gradient.

    Fields
    ------
    move_mm : (t, 4) of the first end, then of the last, along the two axes across the line.
    information : (t, 4, 4) of these. misfit : (t,) chi-square by which the views disagree.
    """

    move_mm: Float[ArrayLike, "t 4"]
    information: Float[ArrayLike, "t 4 4"]
    misfit: Float[ArrayLike, "t"]


def offsets_of(
    ends_mm: Float[ArrayLike, "2 3"],
    matrix_px: Float[ArrayLike, "3 4"],
    place_px: Float[ArrayLike, "2 2"],
    right: Float[ArrayLike, "2"],
) -> Float[ArrayLike, "2"]:
    """Distances, along `right`, of the image of a line from two places."""
    image = ends_mm @ matrix_px[:, :3].T + matrix_px[None, :, 3]
    line = jnp.cross(image[0], image[1])
    return -(place_px @ line[:2] + line[2]) / (right @ line[:2])


def fit_line(
    ends_mm: Float[ArrayLike, "2 3"],
    axes: Float[ArrayLike, "2 3"],
    matrices_px: Float[ArrayLike, "v 3 4"],
    places_px: Float[ArrayLike, "v 2 2"],
    right: Float[ArrayLike, "v 2"],
    offset_px: Float[ArrayLike, "v 2"],
    information: Float[ArrayLike, "v 2 2"],
) -> LineFit:
    """One line by Gauss and Newton; views without information may hold anything finite."""

    def residual(move: Float[ArrayLike, "4"]) -> Float[ArrayLike, "v 2"]:
        ends = ends_mm + move.reshape(2, 2) @ axes
        return (
            jax.vmap(offsets_of, (None, 0, 0, 0))(ends, matrices_px, places_px, right) - offset_px
        )

    def normal(move: Float[ArrayLike, "4"]) -> LineFit:
        off, slope = residual(move), jax.jacfwd(residual)(move)
        weighted = jnp.einsum("vij,vjk->vik", information, slope)
        gradient = jnp.einsum("vik,vi->k", weighted, off)
        square = jnp.einsum("vi,vij,vj->", off, information, off)
        return LineFit(gradient, jnp.einsum("vij,vik->jk", slope, weighted), square)

    def step(_: ArrayLike, move: Float[ArrayLike, "4"]) -> Float[ArrayLike, "4"]:
        gradient, hessian, _square = normal(move)
        return move - solve_positive_definite(hessian + _LEAST_INFORMATION * jnp.eye(4), gradient)

    move = jax.lax.fori_loop(0, _STEPS, step, jnp.zeros(4))
    _, hessian, square = normal(move)
    return LineFit(move, hessian, square)


@kept_jit
def _lines(
    matrices_px: Float[ArrayLike, "v 3 4"],
    ends_mm: Float[ArrayLike, "t 2 3"],
    axes: Float[ArrayLike, "t 2 3"],
    places_px: Float[ArrayLike, "t v 2 2"],
    right: Float[ArrayLike, "t v 2"],
    offset_px: Float[ArrayLike, "t v 2"],
    information: Float[ArrayLike, "t v 2 2"],
) -> LineFit:
    return jax.vmap(fit_line, in_axes=(0, 0, None, 0, 0, 0, 0))(
        ends_mm, axes, matrices_px, places_px, right, offset_px, information
    )


def fit_lines(matrices_px: Float[np.ndarray, "v 3 4"], *columns: np.ndarray) -> LineFit:
    """All lines; columns as `fit_line` takes them, without the matrices."""
    return in_blocks(lambda *rows: _lines(matrices_px, *rows), _LINES_AT_ONCE, *columns)
