"""The grey level of one pixel as a camera delivers it, and its derivatives.

Light on the sheet, a veil that is added to ink and paper alike, the response, a kernel that is no
Gaussian, and sharpening, which comes after the response.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from trinoc.calib.photometric.appearance import Pixels
from trinoc.calib.photometric.ink_coverage import (
    Cross,
    Drawing,
    View,
    ink_near,
)
from trinoc.calib.photometric.kernels import Kernel
from trinoc.calib.photometric.normal_equations import CHUNK
from trinoc.calib.photometric.sheet_point import sheet_point
from trinoc.image import PowerResponse
from trinoc.numerics import ArrayLike

Scalar = Float[ArrayLike, ""]


class CameraLook(NamedTuple):
    """The unknowns of a picture beside pose, light and veil.

    Fields
    ------
    kernel : blur of lens, motion and pixel.
    lobe, lobe_px, lobe_mm : sharpening: weight of a Gaussian that is taken away, by how much it
        is wider than the kernel, and how much further its ink reaches.
    spread_mm : by which ink reaches beyond the drawing.
    ratio : q, grey level of ink over that of paper less one, in the middle of the picture.
    bend : of the response, 0 linear and 1 sRGB.
    lift, contrast : further terms of the response between ink and paper, c (1 - c) and
        c (1 - c) (1 - 2 c) of the share c of ink.
    """

    kernel: Kernel
    lobe: Scalar
    lobe_px: Scalar
    lobe_mm: Scalar
    spread_mm: Scalar
    ratio: Scalar
    bend: Scalar
    lift: Scalar
    contrast: Scalar


LOOK_TERMS = len(Kernel._fields) + len(CameraLook._fields) - 1
# Rows that `predicted_rows` gives: grey, by the homography, by the look, by light and veil.
ROWS = 1 + 9 + LOOK_TERMS + 2


def look_of_vector(vector: Float[ArrayLike, "k"]) -> CameraLook:
    """A look from its numbers in the order of the fields."""
    count = len(Kernel._fields)
    return CameraLook(Kernel(*(vector[k] for k in range(count))),
                      *(vector[k] for k in range(count, LOOK_TERMS)))  # fmt: skip


def grey_level(
    share: Scalar, light: Scalar, veil: Scalar, paper: Scalar, white: Scalar, look: CameraLook
) -> Scalar:
    """Grey level where a share of ink is seen, before sharpening.

    light : grey level of paper here; paper : of paper in the middle of the picture; veil : light
    that is added, as grey levels of a linear camera; white : grey level of a signal of 1.
    """
    rest = share * (1 - share)
    share = share + rest * (look.lift + look.contrast * (1 - 2 * share))
    response = PowerResponse(look.bend)
    of_paper = response.light_of(paper / white)
    of_ink = response.light_of(paper * (1 + look.ratio) / white)
    here = response.light_of(light / white)
    return white * response.level_of(here * (1 - (1 - of_ink / of_paper) * share) + veil / white)


def predict_camera(
    sheet_from_camera: Float[ArrayLike, "3 3"],
    vector: Float[ArrayLike, "k"],
    light: Scalar,
    veil: Scalar,
    pixel: Pixels,
    paper: Scalar,
    white: Scalar,
    cross: Cross,
    drawing: Drawing,
    near_line: bool,
) -> tuple[Scalar, ...]:
    """`ROWS` numbers of one pixel: its grey level and that's derivatives."""
    point = sheet_point(sheet_from_camera, pixel.ray, pixel.unit)
    view = View(sheet_from_camera, pixel.ray, point)
    ink = ink_near(view, pixel.figure, cross, drawing, near_line)

    def grey(
        dx: Scalar, dy: Scalar, terms: tuple[Scalar, ...], light: Scalar, veil: Scalar
    ) -> Scalar:
        count = len(Kernel._fields)
        look = CameraLook(Kernel(*terms[:count]), *terms[count:])
        sharp = ink(dx, dy, look.spread_mm, look.kernel)
        soft = ink(dx, dy, look.spread_mm + look.lobe_mm, look.kernel.widened(look.lobe_px))
        level = grey_level(sharp, light, veil, paper, white, look)
        below = light * (1 + look.ratio * soft) + veil
        return level + look.lobe * (level - below)

    zero = jnp.zeros_like(light)
    terms = tuple(vector[k] for k in range(LOOK_TERMS))
    level, (by_x, by_y, by_look, by_light, by_veil) = jax.value_and_grad(
        grey, argnums=(0, 1, 2, 3, 4)
    )(zero, zero, terms, light, veil)
    values = (level, by_x, by_y, *by_look, by_light, by_veil)
    level, by_x, by_y, *rest = (value / pixel.unit for value in values)
    by_w = -(by_x * point.point_mm[0] + by_y * point.point_mm[1])
    column = point.by_matrix
    return (level, *(row * column[k] for row in (by_x, by_y, by_w) for k in range(3)), *rest)


@partial(jax.jit, static_argnames=("drawing", "near_line"))
def predicted_rows(
    sheet_from_camera: Float[ArrayLike, "3 3"],
    vector: Float[ArrayLike, "k"],
    light: Float[ArrayLike, "n"],
    veil: Float[ArrayLike, "n"],
    pixels: Pixels,
    chunks: Int[ArrayLike, ""],
    paper: Scalar,
    white: Scalar,
    cross: Cross,
    *,
    drawing: Drawing,
    near_line: bool,
) -> Float[ArrayLike, "rows n"]:
    """The rows of the first `chunks` chunks of pixels."""
    dtype = pixels.grey.dtype
    one = partial(predict_camera, drawing=drawing, near_line=near_line)
    many = jax.vmap(one, in_axes=(None, None, 0, 0, 0, None, None, None))
    shared = (sheet_from_camera, vector, paper, white, cross)
    homography, look, paper, white, cross = jax.tree.map(lambda leaf: leaf.astype(dtype), shared)

    def add(k: Int[ArrayLike, ""], rows: Float[ArrayLike, "rows n"]) -> Float[ArrayLike, "rows n"]:
        def part(leaf: ArrayLike) -> ArrayLike:
            return jax.lax.dynamic_slice_in_dim(leaf, k * CHUNK, CHUNK)

        chunk = many(
            homography, look, part(light), part(veil), jax.tree.map(part, pixels),
            paper, white, cross,
        )  # fmt: skip
        return jax.lax.dynamic_update_slice(rows, jnp.stack(chunk), (jnp.zeros_like(k), k * CHUNK))

    start = jnp.zeros((ROWS, len(light)), dtype)
    return jax.lax.fori_loop(0, chunks, add, start)
