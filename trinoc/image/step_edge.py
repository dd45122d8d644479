"""Model of an edge: a step between two levels along a line, convolved with a Gaussian.

All edge positions come from this model. Three estimators exist: the slopes of levels across the
edge (`log_parabola`, `height_of_step`), mean profiles with a prior (`fit_profiles`), and a block of
pixels with its own levels and slopes (`fit_block`).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
from jax.scipy.special import ndtr
from jaxtyping import Bool, Float, Int

from trinoc.numerics.precision import ArrayLike, ScalarLike, is_traced
from trinoc.numerics.small_least_squares import Residuals, gauss_newton
from trinoc.numerics.small_matrices import solve_positive_definite

_SMALLEST = np.float32(1e-6)
# Prior information on a position or level without a prior, for a regular system.
_WEAK_INFORMATION = 1e-6


def blurred_step(across_px: Any, width_px: Any) -> tuple[Any, Any]:
    """Share of a blurred step at a distance from its edge, with its derivative, elementwise.

    Parameters
    ----------
    across_px : array
        Signed distance from the edge.
    width_px : array
        Blur: standard deviation of the Gaussian.

    Returns
    -------
    Share of the step's height, 0 to 1, and its derivative with respect to the distance, per px.
    """
    xp, reached = (jnp, ndtr) if is_traced(across_px, width_px) else (np, scipy.special.ndtr)
    scaled = across_px / width_px
    return reached(scaled), xp.exp(-0.5 * scaled**2) / (np.sqrt(2 * np.pi) * width_px)


def height_of_step(
    slope: Float[np.ndarray, "*n"], variance_px2: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Height of a blurred step, grey levels, from the slope at its middle.

    Parameters
    ----------
    slope : (...)
        Slope at the middle, grey levels per px.
    variance_px2 : (...)
        Variance of the blur.
    """
    return slope * np.sqrt(2 * np.pi * variance_px2)


def log_parabola(
    slope: Float[np.ndarray, "*n 3"], smallest: Float[np.ndarray, "*n 1"] | np.float32 = _SMALLEST
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Differences of the logarithms of three slopes across an edge, one unit apart.

    The slope of a blurred step is a Gaussian. With the two returned values a and b, its peak is a /
    b beyond the middle position, and its variance is 1 / b. An oblique section is also a Gaussian.
    Samples along an image axis are therefore sufficient.

    Parameters
    ----------
    slope : (..., 3)
        Slopes of the grey level.
    smallest : scalar or (..., 1)
        Smaller slopes are replaced by this value.

    Returns
    -------
    First difference and negative second difference of the logarithms.
    """
    level = np.log(np.maximum(slope, smallest))
    low, high = level[..., 0] - level[..., 1], level[..., 2] - level[..., 1]
    return (high - low) / 2, -(low + high)


def peak_of_slope(
    slope: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Position of a blurred step relative to the middle sample, and variance of its blur.

    Parameters
    ----------
    slope : (n, 3)
        Slopes of the grey level at three positions across the edge, one unit apart.
    """
    first_difference, curvature = log_parabola(slope)
    curvature = np.maximum(curvature, _SMALLEST)
    return first_difference / curvature, 1 / curvature


def blur_of_two_slopes(squared_ratio: float, fine_px: float, coarse_px: float) -> float:
    """Blur of a step, px, from its slopes after two Gaussian filters.

    Parameters
    ----------
    squared_ratio : float
        Squared ratio of the slopes: (slope after the fine filter / slope after the coarse
        filter)^2.
    fine_px, coarse_px : float
        Standard deviations of the filters.

    Notes
    -----
    After a Gaussian filter of scale a, a step of height h and blur s has a slope proportional to h
    / sqrt(s^2 + a^2). The ratio of two slopes therefore determines s for any height.

    References
    ----------
    S. Zhuo and T. Sim, "Defocus map estimation from a single image", Pattern Recognition 44(9),
    2011, doi 10.1016/j.patcog.2011.03.009.
    """
    # For wide blur the ratio is near 1 and gives only a bound.
    variance = (coarse_px**2 - squared_ratio * fine_px**2) / max(squared_ratio - 1.0, 1e-2)
    return float(np.sqrt(max(variance, 0.0)))


class ProfileFit(NamedTuple):
    """Blurred steps fitted to s grey profiles.

    Attributes
    ----------
    position_px : (s,)
        Position of each step.
    log_width : (s,)
        Logarithm of the blur, px.
    variance_px2 : (s,)
        Variance of the position.
    chi_square : (s,)
        Chi-square of the levels, without the prior.
    """

    position_px: Float[np.ndarray, "s"]
    log_width: Float[np.ndarray, "s"]
    variance_px2: Float[np.ndarray, "s"]
    chi_square: Float[np.ndarray, "s"]


# Largest step of each unknown: position, log height, lower level, log width.
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
    smallest_log_height: float,
) -> ProfileFit:
    """Fit blurred steps to grey profiles, with a Gaussian prior.

    Parameters
    ----------
    across_px : (s, b)
        Distance of each sample of each profile from the edge.
    level : (s, b)
        Grey levels.
    information : (s, b)
        Inverse variance of each level; 0 excludes the level.
    visible : (s,)
        Observed height of each step. It is the unit of the fitted height.
    start, prior : (s, 4)
        Initial values and prior means of the unknowns: position, log of the height divided by
        `visible`, lower level, log of the width.
    precision : (4,)
        Inverse variance of the prior; 0 for no prior.
    smallest_log_height : float
        Lower bound of the second unknown.
    """
    # A step outside the profile is not observable.
    nearest, farthest = across_px.min(axis=1), across_px.max(axis=1)
    used = information > 0
    first = np.argsort(~used, axis=1, kind="stable")[:, : used.sum(axis=1).max(initial=1)]
    across_px, level, information = (
        np.take_along_axis(array, first, axis=1) for array in (across_px, level, information)
    )
    root, precision = np.sqrt(information), np.maximum(precision, _WEAK_INFORMATION)

    def residuals(state: Float[np.ndarray, "s 4"]) -> Residuals:
        position, log_height, base, log_width = (column[:, None] for column in state.T)
        off, width = across_px - position, np.exp(log_width)
        share, slope = blurred_step(off, width)
        rise = root * (visible[:, None] * np.exp(log_height))
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
        after[:, 0] = np.clip(after[:, 0], nearest, farthest)
        after[:, 1] = np.maximum(after[:, 1], smallest_log_height)
        return after

    state, equations = gauss_newton(
        residuals, retract, start, steps=_STEPS, largest_step=_LARGEST_STEP
    )
    variance = equations.covariance()[:, 0, 0]
    return ProfileFit(state[:, 0], state[:, 3], variance, equations.chi_square)


class BlockFit(NamedTuple):
    """Quadratic approximation of the log likelihood of an edge in one block of pixels.

    Attributes
    ----------
    information : (3, 3)
        Information matrix, for noise of variance 1, of three parameters: the offsets of the edge at
        both ends and the log of the blur.
    gradient : (3,)
        Gradient of the log likelihood with respect to these parameters.
    square : ()
        Sum of the squared residuals.
    count : (2,)
        Numbers of fitted pixels on the left and on the right of the edge.
    column : (c,)
        Sum of the residuals of the usable pixels in each column.
    inner : (c,)
        True for columns that contain pixels of the core, which is the zone near the edge.
    step : ()
        Grey level on the right minus grey level on the left.
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
    state: Float[ArrayLike, "3"],
    noise: ScalarLike,
) -> BlockFit:
    """Quadratic approximation of the log likelihood of an edge in a block of pixels.

    On each side of the edge, the level is constant with small slopes across and along the edge. The
    step between the two sides is blurred. Levels and slopes are linear parameters and are
    eliminated (variable projection: Golub and Pereyra, 1973, doi:10.1137/0710036).

    Parameters
    ----------
    core : (2,)
        Half width of the core, which is the fitted zone near the edge: core[0] blur widths plus
        core[1] px.
    slopes : (2,)
        Prior standard deviations of the slopes across and along the edge, grey levels per px.
    across_px : (r, c)
        Distance of each pixel from the line through the segment.
    share : (r, c)
        Position of each pixel along the segment: 0 at the first end, 1 at the second end.
    level : (r, c)
        Grey levels.
    usable : (r, c)
        Mask of the pixels that may be fitted.
    reach : (c,)
        Mask of the columns whose usable pixels are all fitted, also those outside the core.
    state : (3,)
        Offsets of the edge from the line at both ends, px, and log of the blur.
    noise : float
        Standard deviation of the noise, grey levels; it scales the prior of the slopes.
    """
    across = across_px - ((1 - share) * state[0] + share * state[1])
    width = jnp.exp(state[2])
    inner = usable & (jnp.abs(across) < core[0] * width + core[1])
    fitted = usable & (inner | reach[None])
    weight = fitted.astype(level.dtype).reshape(-1)

    right, bell = (part.reshape(-1) for part in blurred_step(across, width))
    rows = jnp.arange(len(level), dtype=level.dtype) - (len(level) - 1) / 2
    along = jnp.broadcast_to(rows[:, None], across.shape)
    side = jnp.stack([jnp.ones_like(across), across, along], axis=-1).reshape(-1, 3)
    basis = jnp.concatenate([side * (1 - right)[:, None], side * right[:, None]], axis=1)
    # Priors of slopes are in grey levels; noise is 1 here.
    prior_information = jnp.concatenate([jnp.full(1, _WEAK_INFORMATION), (noise / slopes) ** 2])
    normal = basis.T @ (weight[:, None] * basis) + jnp.diag(jnp.tile(prior_information, 2))
    mean = (weight * level.reshape(-1)).sum() / jnp.maximum(weight.sum(), 1.0)
    values = level.reshape(-1) - mean
    levels = solve_positive_definite(normal, basis.T @ (weight * values))
    residual = values - basis @ levels

    between = side @ (levels[3:] - levels[:3])
    by_across = bell * between + levels[1] * (1 - right) + levels[4] * right
    by_blur = -across.reshape(-1) * bell * between
    end_share = share.reshape(-1)
    slope = jnp.stack([-by_across * (1 - end_share), -by_across * end_share, by_blur], axis=1)
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
