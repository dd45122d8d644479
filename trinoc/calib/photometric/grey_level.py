"""The grey levels of pixels as a camera delivers them, and their derivatives.

I = L (1 + q c) where a camera is ideal: a light L on the sheet, and ink that covers a share c and
reflects 1 + q of what paper does. One light for both, because two fields of their own would bend
to swallow whatever covers the sheet. Else a veil that is added to ink and paper alike, a response,
a kernel that is no Gaussian, and sharpening, which comes after the response. What an ideal camera
does not have is not compiled for one.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.photometric.edges import Kernel
from trinoc.calib.photometric.ink import (
    Circle,
    Cross,
    InkDrawing,
    InkShare,
    PixelView,
    Squares,
    nearest_ink,
)
from trinoc.calib.photometric.sheet_places import Ray, SheetPoint, sheet_point
from trinoc.calib.photometric.unknowns import PictureState
from trinoc.image.response import PowerResponse
from trinoc.numerics.precision import ArrayLike

Scalar = Float[ArrayLike, ""]


class Pixels(NamedTuple):
    """Pixels of one picture that take part, along the first axis, and what the model needs of them.

    Fields
    ------
    ray : where it looks.
    place : (n, 2) (u, v) about the picture's middle in units of half its width.
    grey : observed.
    weight : one over the standard deviation of its residual, or 0 for padding and for pixels that
        are cut.
    sigma : standard deviation of its noise, before saturation.
    unit : 1 (see `SheetPoint`).
    figure : the nearest circle, or the ink about it on a board of squares.
    """

    ray: Ray
    place: Float[ArrayLike, "n 2"]
    grey: Float[ArrayLike, "n"]
    weight: Float[ArrayLike, "n"]
    sigma: Float[ArrayLike, "n"]
    unit: Float[ArrayLike, "n"]
    figure: Circle | Squares


class Signal(NamedTuple):
    """What makes a grey level, of a pixel or of many.

    Fields
    ------
    sharp, soft : shares of ink, under the kernel and under that of sharpening.
    light : grey level of paper.
    veil : light that is added, as grey levels of a linear camera.
    """

    sharp: Float[ArrayLike, "*n"]
    soft: Float[ArrayLike, "*n"]
    light: Float[ArrayLike, "*n"]
    veil: Float[ArrayLike, "*n"]


class Tone(NamedTuple):
    """How a signal becomes a grey level; see `unknowns`."""

    ratio: Scalar
    bend: Scalar
    lift: Scalar
    contrast: Scalar
    lobe: Scalar


class Levels(NamedTuple):
    """Grey levels of pixels before saturation, and rows of derivatives.

    Fields
    ------
    level : (n,)
    by_homography : nine, with respect to the rows of the sheet-from-camera homography.
    by_look : one for each unknown of the look.
    by_light, by_veil : (n,)
    """

    level: Float[ArrayLike, "n"]
    by_homography: list[Float[ArrayLike, "_n"]]
    by_look: list[Float[ArrayLike, "_n"]]
    by_light: Float[ArrayLike, "n"]
    by_veil: Float[ArrayLike, "n"]


class _Ink(NamedTuple):
    """The share of ink that pixels see, and its derivatives."""

    share: Float[ArrayLike, "*n"]
    by_x: Float[ArrayLike, "*n"]
    by_y: Float[ArrayLike, "*n"]
    by_spread: Float[ArrayLike, "*n"]
    by_kernel: Kernel


def predict_levels(
    sheet_from_camera: Float[ArrayLike, "3 3"],
    state: PictureState,
    light: Float[ArrayLike, "n"],
    veil: Float[ArrayLike, "n"],
    pixels: Pixels,
    cross: Cross,
    white: Scalar,
    drawing: InkDrawing,
    near_line: bool,
) -> Levels:
    """Grey levels where light and veil are given; pixels near no line have a simpler model.

    white : grey level of a signal of 1. The derivatives by the response hold the middle's light.
    """
    look = {name: state[name] for name in state.unknowns.look}
    ray, figure = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), (pixels.ray, pixels.figure))
    point = sheet_point(sheet_from_camera, ray, pixels.unit)
    view = PixelView(sheet_from_camera, ray, point)
    ink_of = nearest_ink(view, figure, cross, drawing, near_line)
    if state.unknowns.is_ideal:
        ink = _ink(ink_of, pixels.unit, look["spread_mm"], Kernel(look["sigma_px"]))
        reflected = 1 + look["ratio"] * ink.share
        slope = light * look["ratio"]
        moved = slope * ink.by_x, slope * ink.by_y
        by_look = [slope * ink.by_kernel.sigma_px, slope * ink.by_spread, light * ink.share]
        return Levels(
            light * reflected, _by_homography(point, *moved), by_look, reflected, 0 * light
        )
    blurs, pull_back = jax.vjp(_blurs, look)
    # One after the other: the compiler would look at the edges anew for both.
    ink = jax.lax.map(lambda blur: _ink(ink_of, pixels.unit, *blur), blurs)
    tone = Tone(**{name: look[name] for name in Tone._fields})
    sharp, soft = ink.share
    signal = Signal(sharp, soft, light, veil)
    one = jax.value_and_grad(partial(_grey_level, paper=state.light[0], white=white), (0, 1))
    level, (by_signal, by_tone) = jax.vmap(one, in_axes=(0, None))(signal, tone)
    level, by_signal, by_tone = jax.tree.map(
        lambda value: value / pixels.unit, (level, by_signal, by_tone)
    )
    slope = jnp.stack([by_signal.sharp, by_signal.soft])
    moved = jnp.sum(slope * ink.by_x, axis=0), jnp.sum(slope * ink.by_y, axis=0)
    by_blurs = jax.tree.map(lambda part: slope * part, (ink.by_spread, ink.by_kernel))
    (of_blurs,) = jax.vmap(pull_back, in_axes=1)(by_blurs)
    by_look = [of_blurs[name] + getattr(by_tone, name, 0) for name in look]
    return Levels(level, _by_homography(point, *moved), by_look, by_signal.light, by_signal.veil)


def grey_level(
    share: Scalar, light: Scalar, veil: Scalar, paper: Scalar, white: Scalar, tone: Tone
) -> Scalar:
    """Grey level where a share of ink is seen, before sharpening.

    light : grey level of paper here; paper : of paper in the middle of the picture.
    """
    rest = share * (1 - share)
    share = share + rest * (tone.lift + tone.contrast * (1 - 2 * share))
    response = PowerResponse(tone.bend)
    of_paper = response.light_of(paper / white)
    of_ink = response.light_of(paper * (1 + tone.ratio) / white)
    here = response.light_of(light / white)
    return white * response.level_of(here * (1 - (1 - of_ink / of_paper) * share) + veil / white)


def _grey_level(signal: Signal, tone: Tone, *, paper: Scalar, white: Scalar) -> Scalar:
    """Grey level after sharpening."""
    level = grey_level(signal.sharp, signal.light, signal.veil, paper, white, tone)
    below = signal.light * (1 + tone.ratio * signal.soft) + signal.veil
    return level + tone.lobe * (level - below)


def _ink(ink_of: InkShare, unit: Float[ArrayLike, "n"], spread_mm: Scalar, kernel: Kernel) -> _Ink:
    """Derivatives of all pixels at once: none depends on another's displacement or blur."""
    zero = jnp.zeros_like(unit)
    blur = jax.tree.map(lambda value: jnp.broadcast_to(value, unit.shape), (spread_mm, kernel))
    share, pull_back = jax.vjp(ink_of, zero, zero, *blur)
    ink = _Ink(share, *pull_back(jnp.ones_like(share)))
    return jax.tree.map(lambda value: value / unit, ink)


def _blurs(look: dict[str, Scalar]) -> tuple[Float[ArrayLike, "2"], Kernel]:
    """Ink spread and kernel of the picture, and of the Gaussian that sharpening takes away."""
    kernel = Kernel(**{name: look[name] for name in Kernel._fields})
    sigma, zero = jnp.sqrt(kernel.sigma_px**2 + look["lobe_px"] ** 2), jnp.zeros_like(look["lobe"])
    wide = Kernel(sigma, zero, zero, kernel.along_u, kernel.diagonal, zero, zero)
    spread = jnp.stack([look["spread_mm"], look["spread_mm"] + look["lobe_mm"]])
    return spread, jax.tree.map(lambda *both: jnp.stack(both), kernel, wide)


def _by_homography(
    point: SheetPoint, by_x: Float[ArrayLike, "n"], by_y: Float[ArrayLike, "n"]
) -> list[Float[ArrayLike, "_n"]]:
    by_w = -(by_x * point.point_mm[0] + by_y * point.point_mm[1])
    return [row * point.by_matrix[k] for row in (by_x, by_y, by_w) for k in range(3)]
