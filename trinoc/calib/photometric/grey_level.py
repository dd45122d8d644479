"""Model of the grey levels of pixels, with derivatives.

For the ideal camera a grey level is I = L (1 + q c). L is the light on the sheet and c the share of
ink, which reflects 1 + q times as much as paper. Paper and ink have the same light:
two separate fields would adapt to objects that cover the sheet. The full model adds a veil (equal
for ink and paper), a response, a non-Gaussian kernel, and sharpening after the response. These
terms are not compiled for the ideal camera.
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
from trinoc.calib.photometric.sheet_geometry import Ray, SheetPoint, sheet_point
from trinoc.calib.photometric.unknowns import ImageState
from trinoc.image.response import PowerResponse
from trinoc.numerics.precision import ArrayLike

Scalar = Float[ArrayLike, ""]


class Pixels(NamedTuple):
    """Selected pixels of one image, with the constants of their model.

    The first axis of each array counts the n pixels.

    Attributes
    ----------
    ray : ray of each pixel in the camera frame.
    position : (n, 2) pixel coordinates (u, v) relative to the image centre, in half image widths.
    grey : (n,) observed grey levels.
    weight : (n,) reciprocal standard deviation of the residual; 0 for padding and outliers.
    sigma : (n,) standard deviation of the noise before saturation, grey levels.
    unit : (n,) ones (see `SheetPoint`).
    local_ink : circle nearest to each pixel, or the inked squares around each pixel of a board of
        squares.
    """

    ray: Ray
    position: Float[ArrayLike, "n 2"]
    grey: Float[ArrayLike, "n"]
    weight: Float[ArrayLike, "n"]
    sigma: Float[ArrayLike, "n"]
    unit: Float[ArrayLike, "n"]
    local_ink: Circle | Squares


class Signal(NamedTuple):
    """Ink and light at one pixel or at many pixels; the grey level is computed from them.

    Attributes
    ----------
    sharp : share of ink in the pixel under the blur kernel.
    soft : share of ink under the wider kernel that a sharpening filter subtracts.
    light : grey level of paper at the pixel.
    veil : additional light on paper and ink alike, in grey levels of a linear camera.
    """

    sharp: Float[ArrayLike, "*n"]
    soft: Float[ArrayLike, "*n"]
    light: Float[ArrayLike, "*n"]
    veil: Float[ArrayLike, "*n"]


class Tone(NamedTuple):
    """Parameters that convert a share of ink and a light to a grey level.

    Attributes
    ----------
    ratio : grey level of ink divided by that of paper, minus 1.
    bend : curvature of the camera's response (0 linear, 1 sRGB).
    lift, contrast : coefficients of c (1 - c) and c (1 - c) (1 - 2 c) in the response, with c the
        share of ink.
    lobe : weight of the blurred image that sharpening subtracts.
    """

    ratio: Scalar
    bend: Scalar
    lift: Scalar
    contrast: Scalar
    lobe: Scalar


class Levels(NamedTuple):
    """Predicted grey levels of n pixels before saturation, and their derivatives.

    Attributes
    ----------
    level : (n,) grey levels.
    by_homography : nine arrays (n,), derivatives with respect to the elements of the
        sheet-from-camera homography.
    by_appearance : one array (n,) for each unknown of blur, ink and response.
    by_light, by_veil : (n,) derivatives with respect to the light and to the veil (additional light
        on paper and ink alike) at the pixel.
    """

    level: Float[ArrayLike, "n"]
    by_homography: list[Float[ArrayLike, "_n"]]
    by_appearance: list[Float[ArrayLike, "_n"]]
    by_light: Float[ArrayLike, "n"]
    by_veil: Float[ArrayLike, "n"]


class _Ink(NamedTuple):
    """Share of ink in each pixel, and its derivatives.

    The derivatives are with respect to a displacement on the sheet (x, y), mm, to the width by
    which the ink spreads beyond its drawn edges, mm, and to the parameters of the kernel.
    """

    share: Float[ArrayLike, "*n"]
    by_x: Float[ArrayLike, "*n"]
    by_y: Float[ArrayLike, "*n"]
    by_spread: Float[ArrayLike, "*n"]
    by_kernel: Kernel


def predict_levels(
    sheet_from_camera: Float[ArrayLike, "3 3"],
    state: ImageState,
    light: Float[ArrayLike, "n"],
    veil: Float[ArrayLike, "n"],
    pixels: Pixels,
    cross: Cross,
    white: Scalar,
    drawing: InkDrawing,
    near_line: bool,
) -> Levels:
    """Predict the grey levels of pixels, with derivatives.

    The derivatives with respect to the response assume a constant light in the centre of the image.

    Parameters
    ----------
    sheet_from_camera : homography from rays in the camera frame to the sheet.
    state : values of the unknowns.
    light : (n,) grey level of paper at each pixel.
    veil : (n,) additional light on paper and ink alike at each pixel, grey levels.
    pixels : the pixels.
    cross, drawing : crossed lines and properties of the sheet.
    white : grey level of a full signal.
    near_line : True for pixels near a line. The model of other pixels contains circles only.
    """
    appearance = {name: state[name] for name in state.unknowns.appearance}
    ray, local_ink = jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf, 0, -1), (pixels.ray, pixels.local_ink)
    )
    point = sheet_point(sheet_from_camera, ray, pixels.unit)
    view = PixelView(sheet_from_camera, ray, point)
    ink_of = nearest_ink(view, local_ink, cross, drawing, near_line)
    if state.unknowns.is_ideal:
        ink = _ink(ink_of, pixels.unit, appearance["spread_mm"], Kernel(appearance["sigma_px"]))
        reflected = 1 + appearance["ratio"] * ink.share
        slope = light * appearance["ratio"]
        moved = slope * ink.by_x, slope * ink.by_y
        by_appearance = [slope * ink.by_kernel.sigma_px, slope * ink.by_spread, light * ink.share]
        return Levels(
            light * reflected, _by_homography(point, *moved), by_appearance, reflected, 0 * light
        )
    blurs, pull_back = jax.vjp(_blurs, appearance)
    # Sequentially: otherwise the compiler evaluates the edges twice.
    ink = jax.lax.map(lambda blur: _ink(ink_of, pixels.unit, *blur), blurs)
    tone = Tone(**{name: appearance[name] for name in Tone._fields})
    sharp, soft = ink.share
    signal = Signal(sharp, soft, light, veil)
    level_and_slope = jax.value_and_grad(
        partial(_grey_level, paper=state.light[0], white=white), (0, 1)
    )
    level, (by_signal, by_tone) = jax.vmap(level_and_slope, in_axes=(0, None))(signal, tone)
    level, by_signal, by_tone = jax.tree.map(
        lambda value: value / pixels.unit, (level, by_signal, by_tone)
    )
    slope = jnp.stack([by_signal.sharp, by_signal.soft])
    moved = jnp.sum(slope * ink.by_x, axis=0), jnp.sum(slope * ink.by_y, axis=0)
    by_blurs = jax.tree.map(lambda part: slope * part, (ink.by_spread, ink.by_kernel))
    (by_kernel,) = jax.vmap(pull_back, in_axes=1)(by_blurs)
    by_appearance = [by_kernel[name] + getattr(by_tone, name, 0) for name in appearance]
    return Levels(
        level, _by_homography(point, *moved), by_appearance, by_signal.light, by_signal.veil
    )


def grey_level(
    share: Scalar, light: Scalar, veil: Scalar, paper: Scalar, white: Scalar, tone: Tone
) -> Scalar:
    """Grey level of a pixel with a given share of ink, before sharpening.

    Parameters
    ----------
    share : share of ink in the pixel, 0 to 1.
    light : grey level of paper at the pixel.
    veil : additional light, in grey levels of a linear camera.
    paper : grey level of paper in the centre of the image.
    white : grey level of a full signal.
    tone : reflectance of the ink and response of the camera.
    """
    bump = share * (1 - share)
    share = share + bump * (tone.lift + tone.contrast * (1 - 2 * share))
    response = PowerResponse(tone.bend)
    paper_light = response.light_of(paper / white)
    ink_light = response.light_of(paper * (1 + tone.ratio) / white)
    pixel_light = response.light_of(light / white)
    reflected = pixel_light * (1 - (1 - ink_light / paper_light) * share)
    return white * response.level_of(reflected + veil / white)


def _grey_level(signal: Signal, tone: Tone, *, paper: Scalar, white: Scalar) -> Scalar:
    """Grey level of a signal after the camera's response and its sharpening."""
    level = grey_level(signal.sharp, signal.light, signal.veil, paper, white, tone)
    smoothed = signal.light * (1 + tone.ratio * signal.soft) + signal.veil
    return level + tone.lobe * (level - smoothed)


def _ink(ink_of: InkShare, unit: Float[ArrayLike, "n"], spread_mm: Scalar, kernel: Kernel) -> _Ink:
    """Share of ink in each pixel, and its derivatives.

    One call of the vector-Jacobian product serves all pixels, because each share depends on its own
    pixel only.
    """
    zero = jnp.zeros_like(unit)
    blur = jax.tree.map(lambda value: jnp.broadcast_to(value, unit.shape), (spread_mm, kernel))
    share, pull_back = jax.vjp(ink_of, zero, zero, *blur)
    ink = _Ink(share, *pull_back(jnp.ones_like(share)))
    return jax.tree.map(lambda value: value / unit, ink)


def _blurs(appearance: dict[str, Scalar]) -> tuple[Float[ArrayLike, "2"], Kernel]:
    """Ink spread, mm, and blur kernel, each as two values.

    The first value belongs to the image, the second to the Gaussian that sharpening subtracts.
    """
    kernel = Kernel(**{name: appearance[name] for name in Kernel._fields})
    sigma, zero = (
        jnp.sqrt(kernel.sigma_px**2 + appearance["lobe_px"] ** 2),
        jnp.zeros_like(appearance["lobe"]),
    )
    wide = Kernel(sigma, zero, zero, kernel.along_u, kernel.diagonal, zero, zero)
    spread_mm = appearance["spread_mm"]
    spread = jnp.stack([spread_mm, spread_mm + appearance["lobe_mm"]])
    return spread, jax.tree.map(lambda *both: jnp.stack(both), kernel, wide)


def _by_homography(
    point: SheetPoint, by_x: Float[ArrayLike, "n"], by_y: Float[ArrayLike, "n"]
) -> list[Float[ArrayLike, "_n"]]:
    """Derivatives with respect to the nine elements of the homography.

    by_x, by_y : derivatives with respect to the position X, Y on the sheet, 1/mm.
    """
    by_w = -(by_x * point.point_mm[0] + by_y * point.point_mm[1])
    return [row * point.by_matrix[k] for row in (by_x, by_y, by_w) for k in range(3)]
