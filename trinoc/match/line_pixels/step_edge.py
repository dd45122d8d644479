"""One block of pixels against a blurred step: what it says of the place of an edge.

Levels are constant, with a little slope across and along, on either side of the line, and the step
between them is convolved with a Gaussian. Levels and slopes are linear, and are eliminated
(variable projection: Golub and Pereyra, 1973, doi:10.1137/0710036). What remains is a quadratic
form in the place of the line at its two ends and the logarithm of the blur.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.special import ndtr
from jaxtyping import Bool, Float, Int

from trinoc.match.line_pixels.strips import ROWS
from trinoc.numerics import ArrayLike, solve_positive_definite

# Information about a level that nothing is known of.
_HARDLY_ANY = 1e-6


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
    noise: Float[ArrayLike, ""],
) -> BlockFit:
    """The quadratic form at a place (offsets at both ends, logarithm of the blur).

    core : widths, and px, to both sides of the line that are fitted in any case; `reach` says
    which columns are besides. slopes : standard deviations of slopes across and along, per px.
    """
    across = across_px - ((1 - share) * place[0] + share * place[1])
    width = jnp.exp(place[2])
    scaled = across / width
    inner = usable & (jnp.abs(across) < core[0] * width + core[1])
    fitted = usable & (inner | reach[None])
    weight = fitted.astype(level.dtype).reshape(-1)

    right, bell = ndtr(scaled), jnp.exp(-0.5 * scaled**2) / (jnp.sqrt(2 * jnp.pi) * width)
    rows = jnp.arange(ROWS, dtype=level.dtype) - (ROWS - 1) / 2
    along = jnp.broadcast_to(rows[:, None], across.shape)
    side = jnp.stack([jnp.ones_like(across), across, along], axis=-1).reshape(-1, 3)
    right, bell = right.reshape(-1, 1), bell.reshape(-1)
    basis = jnp.concatenate([side * (1 - right), side * right], axis=1)
    # Priors of slopes are in grey levels, and the noise is one here.
    known = jnp.concatenate([jnp.full(1, _HARDLY_ANY), (noise / slopes) ** 2])
    normal = basis.T @ (weight[:, None] * basis) + jnp.diag(jnp.tile(known, 2))
    mean = (weight * level.reshape(-1)).sum() / jnp.maximum(weight.sum(), 1.0)
    values = level.reshape(-1) - mean
    levels = solve_positive_definite(normal, basis.T @ (weight * values))
    residual = values - basis @ levels

    between = side @ (levels[3:] - levels[:3])
    by_across = bell * between + levels[1] * (1 - right[:, 0]) + levels[4] * right[:, 0]
    by_blur = -scaled.reshape(-1) * bell * width * between
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
