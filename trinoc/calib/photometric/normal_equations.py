"""Normal equations over many pixels, in chunks that stay in the cache.

Pixels are handled in the precision of their arrays (single is enough, and twice as fast), sums
in that of the homography. The number of chunks is data: one compiled program serves any number of
pixels up to the length of the padded arrays.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from trinoc.calib.photometric.appearance import NUISANCE, Appearance, Pixels, Prediction, predict
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.numerics import AbstractRobustLoss, ArrayLike

CHUNK = 512
_ROW = 9 + NUISANCE


class NormalEquations(NamedTuple):
    """Sums over pixels, with respect to (homography, appearance).

    Fields
    ------
    matrix : (18, 18) sum of w J^T J.
    gradient : (18,) sum of w J^T r.
    residuals : (n,) predicted minus observed grey levels, padding included.
    columns : (12, n) their derivatives by the third column of the homography, which a shift of the
        picture changes, and by the appearance.
    """

    matrix: Float[ArrayLike, "18 18"]
    gradient: Float[ArrayLike, "18"]
    residuals: Float[ArrayLike, "n"]
    columns: Float[ArrayLike, "12 n"]


def normal_equations(
    sheet_from_camera: Float[ArrayLike, "3 3"],
    appearance: Appearance,
    pixels: Pixels,
    chunks: Int[ArrayLike, ""],
    cross: Cross,
    loss: AbstractRobustLoss,
    drawing: Drawing,
    near_line: bool,
) -> NormalEquations:
    """Gauss-Newton sums over the first `chunks` chunks of `pixels`.

    `loss` bounds what a residual can cost, in grey levels squared.
    """

    def add(k: Int[ArrayLike, ""], sums: NormalEquations) -> NormalEquations:
        part = _chunk(pixels, k)
        predicted = _predict_chunk(sheet_from_camera, appearance, part, cross, drawing, near_line)
        residual = predicted.residual
        # The square root of the weight: rows and residual then share one product.
        root = part.weight * loss.root_weight(residual**2)
        columns = (*predicted.by_homography, *predicted.by_appearance, residual)
        rows = jnp.stack([column * root for column in columns])
        products = (rows @ rows.T).astype(dtype)
        return NormalEquations(
            sums.matrix + products[:_ROW, :_ROW],
            sums.gradient + products[:_ROW, _ROW],
            jax.lax.dynamic_update_slice(sums.residuals, residual, (k * CHUNK,)),
            jax.lax.dynamic_update_slice(
                sums.columns,
                jnp.stack((*predicted.by_homography[2::3], *predicted.by_appearance)),
                (jnp.zeros_like(k), k * CHUNK),
            ),
        )

    dtype = sheet_from_camera.dtype
    loss = jax.tree.map(lambda leaf: leaf.astype(pixels.grey.dtype), loss)
    start = NormalEquations(
        jnp.zeros((_ROW, _ROW), dtype),
        jnp.zeros(_ROW, dtype),
        jnp.zeros_like(pixels.grey),
        jnp.zeros((3 + NUISANCE, len(pixels.grey)), pixels.grey.dtype),
    )
    sums = jax.lax.fori_loop(0, chunks, add, start)
    rounding = _rounding(sheet_from_camera, appearance, pixels.grey.dtype)
    return sums._replace(gradient=sums.gradient + sums.matrix @ rounding)


def _rounding(
    sheet_from_camera: Float[ArrayLike, "3 3"], appearance: Appearance, dtype: jnp.dtype
) -> Float[ArrayLike, "18"]:
    """What the unknowns lose in the precision of the pixels.

    All pixels lose it alike, so that in a large picture it outweighs their noise.
    """
    exact = jnp.concatenate([sheet_from_camera.reshape(9), appearance.vector])
    return exact - exact.astype(dtype).astype(exact.dtype)


def _chunk(pixels: Pixels, k: Int[ArrayLike, ""]) -> Pixels:
    return jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, k * CHUNK, CHUNK), pixels)


def _predict_chunk(
    sheet_from_camera: Float[ArrayLike, "3 3"],
    appearance: Appearance,
    pixels: Pixels,
    cross: Cross,
    drawing: Drawing,
    near_line: bool,
) -> Prediction:
    one = partial(predict, drawing=drawing, near_line=near_line)
    shared = (sheet_from_camera, appearance, cross)
    homography, look, lines = jax.tree.map(lambda leaf: leaf.astype(pixels.grey.dtype), shared)
    return jax.vmap(one, in_axes=(None, None, 0, None))(homography, look, pixels, lines)
