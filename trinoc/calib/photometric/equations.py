"""Normal equations of a picture's unknowns, priors included, light of blocks eliminated.

Pixels are handled in chunks that stay in the cache, in the precision of their arrays (single is
enough, and twice as fast), sums in that of the homography. The number of chunks is data: one
compiled program serves any number of pixels up to the length of the padded arrays.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from trinoc.calib.photometric.grey_level import Pixels, predict_levels
from trinoc.calib.photometric.ink import Cross, InkDrawing
from trinoc.calib.photometric.noise import clipped_moments
from trinoc.calib.photometric.sheet_places import sheet_from_camera
from trinoc.calib.photometric.unknowns import (
    LOCAL_TERMS,
    LOCAL_WIDTH,
    PictureState,
    step_unit_mm,
)
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.robust_loss import GemanMcClure

CHUNK = 512  # numerical: a block size


class LocalPixels(NamedTuple):
    """The block that each pixel belongs to, and (1, x, y) about its middle in half pitches."""

    block: Int[ArrayLike, "n"]
    basis: Float[ArrayLike, "n 3"]


class Group(NamedTuple):
    """Pixels that share a model: those near circles only, or those near a line too.

    Fields
    ------
    pixels : padded to whole chunks.
    chunks : how many of them take part.
    local : where light is local, else None.
    """

    pixels: Pixels
    chunks: Int[ArrayLike, ""]
    local: LocalPixels | None = None


class Picture(NamedTuple):
    """What one picture of the sheet shows, and what is known besides.

    Fields
    ------
    near_circles, near_lines : pixels.
    cross : of the sheet.
    white, top : grey level of a full signal, and where saturation cuts (infinity: nowhere).
    prior : middle and weight of each unknown beside the pose.
    """

    near_circles: Group
    near_lines: Group
    cross: Cross
    white: Float[ArrayLike, ""]
    top: Float[ArrayLike, ""]
    prior: tuple[Float[ArrayLike, "k"], Float[ArrayLike, "k"]]


class PixelRows(NamedTuple):
    """What a state says of pixels; of a group's, chunk after chunk, padding included.

    Fields
    ------
    level : (n,) predicted grey level before saturation.
    residual, sigma : (n,) predicted minus observed after saturation, and its standard deviation.
    rows : (9 + k, n) derivatives by the homography and by the unknowns beside the pose, through
        saturation.
    by_local : (2, n) by the light's and the veil's level of the pixel's block; none without.
    """

    level: Float[ArrayLike, "*c n"]
    residual: Float[ArrayLike, "*c n"]
    sigma: Float[ArrayLike, "*c n"]
    rows: Float[ArrayLike, "*c k n"]
    by_local: Float[ArrayLike, "*c l n"]


class LevelElimination(NamedTuple):
    """How the levels of each block follow the other unknowns.

    Fields
    ------
    constant : (b, 6) step of the levels where the rest stays.
    by_rest : (b, 6, k) its change by a step of the rest, both to be subtracted.
    """

    constant: Float[ArrayLike, "b 6"]
    by_rest: Float[ArrayLike, "b 6 k"]

    def levels_after(
        self, levels: Float[ArrayLike, "6 b"], step: Float[ArrayLike, "k"]
    ) -> Float[ArrayLike, "6 b"]:
        """The levels that go with a step of the rest."""
        return levels - (self.constant + self.by_rest @ step).T


class Equations(NamedTuple):
    """Normal equations at a state, by a step of (pose, values).

    Fields
    ------
    matrix, gradient : (k, k) and (k,), priors included, levels eliminated.
    prior_cost : chi-square of the priors.
    by_motion : (9, p) derivative of the homography by a step of the pose.
    elimination : of local levels; None without.
    pixels : of both groups.
    """

    matrix: Float[ArrayLike, "k k"]
    gradient: Float[ArrayLike, "k"]
    prior_cost: Float[ArrayLike, ""]
    by_motion: Float[ArrayLike, "9 p"]
    elimination: LevelElimination | None
    pixels: tuple[PixelRows, PixelRows]


class _Sums(NamedTuple):
    """Sums over pixels: of w J^T J with J = (rows, residual), and that of each block."""

    products: Float[ArrayLike, "k k"]
    of_blocks: Float[ArrayLike, "b 6 l"]
    rows: PixelRows


def build_equations(
    state: PictureState,
    picture: Picture,
    loss: GemanMcClure,
    stride: Int[ArrayLike, ""],
    drawing: InkDrawing,
    model: PoseModel,
) -> Equations:
    """Normal equations over the first of `stride` parts of each group's chunks.

    loss : bounds what a residual can cost, in sigmas squared; an infinite one, nothing.
    """
    homography, by_motion = homography_and_slope(state, model)
    sums = [
        _sum_pixels(
            homography, state, group, -(-group.chunks // stride), picture, loss, drawing, near_line
        )
        for group, near_line in ((picture.near_circles, False), (picture.near_lines, True))
    ]
    chain = _chain(by_motion, state.unknowns.size)
    products = chain.T @ (sums[0].products + sums[1].products) @ chain
    size = len(products) - 1
    middle, weight = (jnp.concatenate([jnp.zeros(model.size), part]) for part in picture.prior)
    offset = jnp.concatenate([jnp.zeros(model.size), state.values]) - middle
    matrix = products[:size, :size] + jnp.diag(weight)
    gradient = products[:size, size] + weight * offset
    prior_cost = weight @ offset**2
    elimination = None
    if state.levels.size:
        of_blocks = sums[0].of_blocks + sums[1].of_blocks
        across = of_blocks[:, :, LOCAL_TERMS:] @ chain
        of_blocks = jnp.concatenate([of_blocks[:, :, :LOCAL_TERMS], across], axis=2)
        less, elimination, of_levels = eliminate_levels(of_blocks, state.levels)
        matrix, gradient = matrix - less[:size, :size], gradient - less[size]
        prior_cost = prior_cost + of_levels
    return Equations(
        matrix, gradient, prior_cost, by_motion, elimination, (sums[0].rows, sums[1].rows)
    )


def eliminate_levels(
    of_blocks: Float[ArrayLike, "b 6 l"], levels: Float[ArrayLike, "6 b"]
) -> tuple[Float[ArrayLike, "m k"], LevelElimination, Float[ArrayLike, ""]]:
    """The Schur complement of every block's levels: what it takes from matrix and gradient (the
    last row), how the levels follow, and chi-square of their priors.

    of_blocks : sums over each block of w l (l, j, r), for rows l of the levels and j of all else,
        and the residual r.
    """
    inner = of_blocks[:, :, :LOCAL_TERMS] + jnp.diag(LOCAL_WIDTH**-2)[None]
    pull = levels.T / LOCAL_WIDTH[None] ** 2
    side = jnp.asarray(of_blocks[:, :, LOCAL_TERMS:]).at[:, :, -1].add(pull)
    solved = jnp.linalg.solve(inner, side)
    elimination = LevelElimination(solved[:, :, -1], solved[:, :, :-1])
    less = jnp.einsum("bil,bik->lk", side, elimination.by_rest)
    return less, elimination, jnp.sum((levels.T / LOCAL_WIDTH[None]) ** 2)


def homography_and_slope(
    state: PictureState, model: PoseModel
) -> tuple[Float[ArrayLike, "3 3"], Float[ArrayLike, "9 p"]]:
    """The homography to the sheet and its derivative by a step of the pose."""
    pose = state.pose

    def after(motion: Float[ArrayLike, "p"]) -> Float[ArrayLike, "9"]:
        moved = pose.retract(motion, model, step_unit_mm(pose, model))
        return sheet_from_camera(moved).reshape(9)

    zero = jnp.zeros(model.size, jnp.asarray(pose.rotation).dtype)
    return after(zero).reshape(3, 3), jax.jacfwd(after)(zero)


def _chain(by_motion: Float[ArrayLike, "9 p"], size: int) -> Float[ArrayLike, "m k"]:
    """From (homography, values, residual) to (pose, values, residual)."""
    return jax.scipy.linalg.block_diag(by_motion, jnp.eye(size + 1, dtype=by_motion.dtype))


def _sum_pixels(
    homography: Float[ArrayLike, "3 3"],
    state: PictureState,
    group: Group,
    chunks: Int[ArrayLike, ""],
    picture: Picture,
    loss: GemanMcClure,
    drawing: InkDrawing,
    near_line: bool,
) -> _Sums:
    dtype, single = homography.dtype, group.pixels.grey.dtype
    count, size = len(group.pixels.grey) // CHUNK, 9 + state.unknowns.size
    # Polynomials hardly differ from local levels: single precision loses the difference.
    precise = dtype if state.levels.size else single

    loss = jax.tree.map(lambda leaf: leaf.astype(single), loss)

    def add(k: Int[ArrayLike, ""], sums: _Sums) -> _Sums:
        part = jax.tree.map(partial(_chunk, k), group._replace(chunks=None))
        seen = pixel_rows(homography, state, part, picture, drawing, near_line)
        # While outliers are among them, saturated pixels are no surer than others.
        sigma = jnp.where(jnp.isfinite(loss.ceiling), part.pixels.sigma, seen.sigma)
        # The square root of the weight: rows and residual then share one product.
        root = part.pixels.weight / sigma * loss.root_weight((seen.residual / sigma) ** 2)
        rows = (jnp.concatenate([seen.rows, seen.residual[None]]) * root[None]).astype(precise)
        of_blocks = sums.of_blocks
        if part.local is not None:
            local = local_rows(seen.by_local, part.local.basis) * root[None]
            local = local.astype(precise)
            both = jnp.concatenate([local, rows])
            products = jnp.einsum("in,jn->nij", local, both)
            of_blocks = jnp.asarray(of_blocks).at[part.local.block].add(products)
        stored = jax.tree.map(lambda whole, piece: whole.at[k].set(piece), sums.rows, seen)
        return _Sums(sums.products + (rows @ rows.T).astype(dtype), of_blocks, stored)

    start = _Sums(
        jnp.zeros((size + 1, size + 1), dtype),
        jnp.zeros((state.levels.shape[1], LOCAL_TERMS, LOCAL_TERMS + size + 1), dtype),
        PixelRows(
            level=jnp.zeros((count, CHUNK), single),
            residual=jnp.zeros((count, CHUNK), single),
            sigma=jnp.zeros((count, CHUNK), single),
            rows=jax.lax.empty((count, size, CHUNK), single),
            by_local=jax.lax.empty((count, 2 if state.levels.size else 0, CHUNK), single),
        ),
    )
    return jax.lax.fori_loop(0, chunks, add, start)


def local_rows(
    by_local: Float[ArrayLike, "2 n"], basis: Float[ArrayLike, "n 3"]
) -> Float[ArrayLike, "6 n"]:
    """Derivatives of each pixel's grey level by the levels of its block."""
    return (by_local[:, None] * basis.T[None]).reshape(LOCAL_TERMS, -1)


def pixel_rows(
    homography: Float[ArrayLike, "3 3"],
    state: PictureState,
    group: Group,
    picture: Picture,
    drawing: InkDrawing,
    near_line: bool,
) -> PixelRows:
    """Residuals and derivatives of pixels, in their precision."""
    pixels, unknowns = group.pixels, state.unknowns
    single = pixels.grey.dtype
    shared = homography, state, picture.cross, picture.white
    plane, rounded, cross, white = jax.tree.map(lambda leaf: jnp.asarray(leaf, single), shared)
    terms = light_terms(pixels.place.T, max(unknowns.light_terms, unknowns.veil_terms))
    of_light, of_veil = terms[: unknowns.light_terms], terms[: unknowns.veil_terms]
    polynomial, veil = rounded.light @ of_light, rounded.veil @ of_veil
    light, factor = polynomial, jnp.ones_like(polynomial)
    if group.local is not None:
        levels, basis = rounded.levels[:, group.local.block], group.local.basis.T
        factor = 1 + jnp.sum(levels[:3] * basis, axis=0)
        light, veil = polynomial * factor, veil + jnp.sum(levels[3:] * basis, axis=0)
    seen = predict_levels(plane, rounded, light, veil, pixels, cross, white, drawing, near_line)
    rows = jnp.concatenate(
        [
            jnp.stack([*seen.by_homography, *seen.by_look]),
            (seen.by_light * factor)[None] * of_light,
            seen.by_veil[None] * of_veil,
        ]
    )
    by_local = jnp.stack([seen.by_light * polynomial, seen.by_veil])[: 2 if group.local else 0]
    # What homography and look lose in the pixels' precision, all pixels lose alike, so that in a
    # large picture it outweighs their noise.
    exact = jnp.concatenate([homography.reshape(9), state.values[: len(unknowns.look)]])
    lost = (exact - exact.astype(single).astype(exact.dtype)).astype(single)
    # Divisions by one: see `SheetPoint.unit`.
    rows, by_local = rows / pixels.unit[None], by_local / pixels.unit[None]
    level = seen.level + lost @ rows[: len(lost)]
    sigma, residual = pixels.sigma, level - pixels.grey
    if not unknowns.is_ideal:
        cut = clipped_moments(level, sigma, picture.top.astype(single))
        residual, sigma, rows = cut.mean - pixels.grey, cut.sigma, rows * cut.slope[None]
        by_local = by_local * cut.slope[None]
    return PixelRows(level, residual, sigma, rows, by_local)


def light_terms(place: Float[ArrayLike, "2 n"], count: int) -> Float[ArrayLike, "m n"]:
    """The first terms of a polynomial in (x, y), lower degrees first."""
    x, y = place
    math = array_namespace(place)
    degree, terms = [math.ones_like(x)], [math.ones_like(x)]
    while len(terms) < count:
        degree = [*(term * x for term in degree), degree[-1] * y]
        terms += degree
    return math.stack(terms[:count])


def _chunk(k: Int[ArrayLike, ""], leaf: ArrayLike) -> ArrayLike:
    return jax.lax.dynamic_slice_in_dim(leaf, k * CHUNK, CHUNK, allow_negative_indices=False)
