"""One blurred step: two levels on either side of a line, convolved with a Gaussian.

Whoever places an edge does it by this model: by the slope of the levels across (`log_parabola`,
`height_of_step`), by mean profiles with something known beforehand (`fit_profiles`), or by a block
of pixels with levels and slopes of its own (`fit_block`).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.special
from jax.scipy.special import ndtr
from jaxtyping import Bool, Float, Int

from trinoc.numerics.precision import ArrayLike, ScalarLike, is_traced
from trinoc.numerics.small_least_squares import Residuals, gauss_newton
from trinoc.numerics.small_matrices import solve_positive_definite

_SMALLEST = np.float32(1e-6)
# Information about a place or a level that nothing is known of.
_HARDLY_ANY = 1e-6


def blurred_step(across_px: Any, width_px: Any) -> tuple[Any, Any]:
    """(share of the step that is reached, its slope per px) so far beyond the edge, for a blur of
    this width, the standard deviation of a Gaussian; elementwise."""
    xp, reached = (jnp, ndtr) if is_traced(across_px, width_px) else (np, scipy.special.ndtr)
    scaled = across_px / width_px
    return reached(scaled), xp.exp(-0.5 * scaled**2) / (np.sqrt(2 * np.pi) * width_px)


def height_of_step(
    slope: Float[np.ndarray, "*n"], variance_px2: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """The height of a step from the slope at its middle."""
    return slope * np.sqrt(2 * np.pi * variance_px2)


def log_parabola(
    slope: Float[np.ndarray, "*n 3"], least: Float[np.ndarray, "*n 1"] | np.float32 = _SMALLEST
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """(rise, bend) of the logarithm of slopes at three places across an edge, one apart.

    The slope of a blurred step is a Gaussian: its peak is rise / bend beyond the middle place, and
    its variance 1 / bend. Cut at a slant it is again a Gaussian, so that samples along an axis of
    the picture do. Slopes are taken to be at least `least`.
    """
    level = np.log(np.maximum(slope, least))
    low, high = level[..., 0] - level[..., 1], level[..., 2] - level[..., 1]
    return (high - low) / 2, -(low + high)


def peak_of_slope(
    slope: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """(offset, variance) of the blurred step with these slopes; the offset is from the middle."""
    rise, bend = log_parabola(slope)
    bend = np.maximum(bend, _SMALLEST)
    return rise / bend, 1 / bend


def blur_of_two_slopes(squared_ratio: float, fine_px: float, coarse_px: float) -> float:
    """Width of a blurred step from the ratio of its slopes, squared, after two Gaussians.

    Seen through a Gaussian of scale a, a step of blur s has a slope of height / sqrt(s^2 + a^2):
    the ratio gives s, whatever the height (S. Zhuo and T. Sim, "Defocus map estimation from a
    single image", Pattern Recognition 44(9), 2011, doi 10.1016/j.patcog.2011.03.009).
    """
    # Wide blur leaves a ratio near 1, of which only a bound can be told.
    variance = (coarse_px**2 - squared_ratio * fine_px**2) / max(squared_ratio - 1.0, 1e-2)
    return float(np.sqrt(max(variance, 0.0)))


class ProfileFit(NamedTuple):
    """Of each profile: place, logarithm of the width, variance of the place, and chi-square."""

    place_px: Float[np.ndarray, "s"]
    log_width: Float[np.ndarray, "s"]
    variance_px2: Float[np.ndarray, "s"]
    chi_square: Float[np.ndarray, "s"]


# At most so much at a time: place, logarithm of the height, floor, logarithm of the width.
_LARGEST_STEP = np.array([0.4, 0.3, np.inf, 0.2])
_STEPS = 20


def fit_profiles(
    across_px: Float[np.ndarray, "s b"],
    level: Float[np.ndarray, "s b"],
    information: Float[np.ndarray, "s b"],
    visible: Float[np.ndarray, "s"],
    start: Float[np.ndarray, "s 4"],
    prior: Float[np.ndarray, "s 4"],
    precision: Float[np.ndarray, "4"],
    least_above: float,
) -> ProfileFit:
    """Blurred steps fitted to profiles, with what is known beforehand.

    Unknowns: place, logarithm of the height over the `visible` one (at least `least_above`), floor,
    logarithm of the width; `precision` is the inverse of the prior's variance, 0 where there is
    none, and `information` that of every level.
    """
    # Beyond the profile nothing is seen of a step.
    least, most = across_px.min(axis=1), across_px.max(axis=1)
    used = information > 0
    first = np.argsort(~used, axis=1, kind="stable")[:, : used.sum(axis=1).max(initial=1)]
    across_px, level, information = (
        np.take_along_axis(each, first, axis=1) for each in (across_px, level, information)
    )
    root, precision = np.sqrt(information), np.maximum(precision, _HARDLY_ANY)

    def residuals(state: Float[np.ndarray, "s 4"]) -> Residuals:
        place, above, base, log_width = (column[:, None] for column in state.T)
        off, width = across_px - place, np.exp(log_width)
        share, slope = blurred_step(off, width)
        rise = root * (visible[:, None] * np.exp(above))
        slopes = np.empty((len(off), 4, off.shape[1]))
        np.multiply(-rise, slope, out=slopes[:, 0])
        np.multiply(rise, share, out=slopes[:, 1])
        slopes[:, 2] = root
        np.multiply(slopes[:, 0], off, out=slopes[:, 3])
        return Residuals(
            (root * (base - level) + slopes[:, 1])[..., None],
            slopes.mT[:, :, None],
            prior_residual=state - prior,
            prior_precision=np.broadcast_to(precision, state.shape),
        )

    def retract(
        state: Float[np.ndarray, "s 4"], step: Float[np.ndarray, "s 4"]
    ) -> Float[np.ndarray, "s 4"]:
        after = state + step
        after[:, 0] = np.clip(after[:, 0], least, most)
        after[:, 1] = np.maximum(after[:, 1], least_above)
        return after

    state, equations = gauss_newton(
        residuals, retract, start, steps=_STEPS, largest_step=_LARGEST_STEP
    )
    variance = equations.covariance()[:, 0, 0]
    return ProfileFit(state[:, 0], state[:, 3], variance, equations.chi_square)


class BlockFit(NamedTuple):
    """Fields
    ------
    information : (3, 3) of the offsets at both ends and of the logarithm of the blur, at noise 1.
    gradient : (3,) of the log likelihood. square : () sum of squared residuals.
    count : (2,) fitted pixels to the left and to the right.
    column : (c,) sum of the residuals of usable pixels. inner : (c,) whether one is in the core.
    step : () from left to right.
    """

    information: Float[ArrayLike, "3 3"]
    gradient: Float[ArrayLike, "3"]
    square: Float[ArrayLike, ""]
    count: Int[ArrayLike, "2"]
    column: Float[ArrayLike, "c"]
    inner: Bool[ArrayLike, "c"]
    step: Float[ArrayLike, ""]


def fit_block(
    core: Float[ArrayLike, "2"],
    slopes: Float[ArrayLike, "2"],
    across_px: Float[ArrayLike, "r c"],
    share: Float[ArrayLike, "r c"],
    level: Float[ArrayLike, "r c"],
    usable: Bool[ArrayLike, "r c"],
    reach: Bool[ArrayLike, "c"],
    place: Float[ArrayLike, "3"],
    noise: ScalarLike,
) -> BlockFit:
    """What a block of pixels says of a place: offsets at both ends, and logarithm of the blur.

    Levels are constant, with a little slope across and along, on either side of the line, and the
    step between them is blurred. Levels and slopes are linear, and are eliminated (variable
    projection: Golub and Pereyra, 1973, doi:10.1137/0710036). What remains is a quadratic form.

    core : widths, and px, to both sides of the line that are fitted in any case; `reach` says
    which columns are besides. slopes : standard deviations of slopes across and along, per px.
    """
    across = across_px - ((1 - share) * place[0] + share * place[1])
    width = jnp.exp(place[2])
    inner = usable & (jnp.abs(across) < core[0] * width + core[1])
    fitted = usable & (inner | reach[None])
    weight = fitted.astype(level.dtype).reshape(-1)

    right, bell = (part.reshape(-1) for part in blurred_step(across, width))
    rows = jnp.arange(len(level), dtype=level.dtype) - (len(level) - 1) / 2
    along = jnp.broadcast_to(rows[:, None], across.shape)
    side = jnp.stack([jnp.ones_like(across), across, along], axis=-1).reshape(-1, 3)
    basis = jnp.concatenate([side * (1 - right)[:, None], side * right[:, None]], axis=1)
    # Priors of slopes are in grey levels, and the noise is one here.
    known = jnp.concatenate([jnp.full(1, _HARDLY_ANY), (noise / slopes) ** 2])
    normal = basis.T @ (weight[:, None] * basis) + jnp.diag(jnp.tile(known, 2))
    mean = (weight * level.reshape(-1)).sum() / jnp.maximum(weight.sum(), 1.0)
    values = level.reshape(-1) - mean
    levels = solve_positive_definite(normal, basis.T @ (weight * values))
    residual = values - basis @ levels

    between = side @ (levels[3:] - levels[:3])
    by_across = bell * between + levels[1] * (1 - right) + levels[4] * right
    by_blur = -across.reshape(-1) * bell * between
    far = share.reshape(-1)
    slope = jnp.stack([-by_across * (1 - far), -by_across * far, by_blur], axis=1)
    weighted = weight[:, None] * slope
    mixed = basis.T @ weighted
    information = slope.T @ weighted - mixed.T @ solve_positive_definite(normal, mixed)
    grid = residual.reshape(across.shape)
    return BlockFit(
        information,
        weighted.T @ residual,
        weight @ residual**2,
        jnp.stack([(fitted & (across < 0)).sum(), (fitted & (across >= 0)).sum()]),
        jnp.where(usable, grid, 0.0).sum(axis=0),
        jnp.any(inner, axis=0),
        levels[3] - levels[0],
    )
