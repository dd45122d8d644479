"""Normal equations of a picture's unknowns: a head of pose and look, and the light of each block.

A picture is predicted first (`predict_picture`), then weighed (`weigh_picture`): another noise, or
pixels that are cut, need no new prediction. Pixels are handled in chunks that stay in the cache, in
the precision of their arrays (single is enough, and twice as fast), sums in that of the homography.
The number of chunks is data: one compiled program serves any number of pixels up to the length of
the padded arrays.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from trinoc.calib.photometric.grey_level import Pixels, predict_levels
from trinoc.calib.photometric.ink import Cross, InkDrawing
from trinoc.calib.photometric.noise import Saturation, clipped_moments
from trinoc.calib.photometric.sheet_places import sheet_from_camera
from trinoc.calib.photometric.unknowns import (
    LOCAL_TERMS,
    PicturePrior,
    PictureState,
    step_unit_mm,
)
from trinoc.calib.problem.solver import AbstractArrowProblem, ArrowEquations
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.block_arrow import BlockArrow
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
    white : grey level of a full signal.
    saturation : where saturation cuts.
    prior : of each unknown beside the pose.
    """

    near_circles: Group
    near_lines: Group
    cross: Cross
    white: Float[ArrayLike, ""]
    saturation: Saturation
    prior: PicturePrior


class PixelRows(NamedTuple):
    """Predicted pixels before saturation; of a group, chunk after chunk, padding included.

    Fields
    ------
    level : (n,) grey level.
    rows : (9 + k, n) its derivatives by the homography and by the unknowns beside the pose.
    by_local : (2, n) by the light's and the veil's level of the pixel's block; none without.
    """

    level: Float[ArrayLike, "*c n"]
    rows: Float[ArrayLike, "*c k n"]
    by_local: Float[ArrayLike, "*c l n"]


class Prediction(NamedTuple):
    """Predicted pixels of both groups, and (9, p) derivative of the homography by the pose."""

    near_circles: PixelRows
    near_lines: PixelRows
    by_motion: Float[ArrayLike, "9 p"]


class PictureProblem(AbstractArrowProblem[PictureState]):
    """One picture as a problem whose head is (pose, values), with the levels of a block as a block.

    Fields
    ------
    picture : pixels with their noise, and priors.
    loss : what a residual can cost, in sigmas squared; infinite for plain least squares.
    free : (k,) 1 for each unknown of the head that is estimated, else 0.
    stride : the first of so many parts of each group's chunks take part.
    drawing, model : the sheet, and what a step may change of the pose.
    """

    picture: Picture
    loss: GemanMcClure
    free: Float[ArrayLike, "k"]
    stride: Int[ArrayLike, ""]
    drawing: InkDrawing = eqx.field(static=True)
    model: PoseModel = eqx.field(static=True)

    def equations(self, state: PictureState) -> ArrowEquations:
        """Equations of the free unknowns; their details are those of all, with the prediction."""
        everything = predict_picture(self, state)
        return self.hold(everything)._replace(details=everything)

    def hold(self, equations: ArrowEquations) -> ArrowEquations:
        """The equations without the unknowns that are fixed."""
        arrow, (of_head, of_blocks), free = equations.information, equations.gradient, self.free
        head = arrow.head * free[:, None] * free[None]
        arrow = BlockArrow(head, arrow.coupling * free[None, :, None], arrow.blocks)
        return ArrowEquations(equations.cost, arrow, (of_head * free, of_blocks))

    def retract(
        self, state: PictureState, head: Float[ArrayLike, "k"], blocks: Float[ArrayLike, "b 6"]
    ) -> PictureState:
        """The state after a step, within the bounds of its unknowns."""
        return state.move(head, state.levels + blocks.T, self.model)


def predict_picture(problem: PictureProblem, state: PictureState) -> ArrowEquations:
    """Equations of all unknowns at a state; their details are the prediction."""
    homography, by_motion = homography_and_slope(state, problem.model)
    sums, rows = [], []
    for group, near_line in _groups(problem.picture):

        def predict(part: Group, near_line: bool = near_line) -> PixelRows:
            picture, drawing = problem.picture, problem.drawing
            return pixel_rows(homography, state, part, picture, drawing, near_line)

        one, predicted = _sum_pixels(problem, state, group, predict)
        sums.append(one)
        rows.append(predicted)
    prediction = Prediction(rows[0], rows[1], by_motion)
    return _equations(problem, state, sums, by_motion)._replace(details=prediction)


def weigh_picture(
    problem: PictureProblem, state: PictureState, prediction: Prediction
) -> ArrowEquations:
    """Equations of all unknowns at a state whose pixels are predicted already."""
    predicted = prediction.near_circles, prediction.near_lines
    sums = [
        _sum_pixels(problem, state, group, rows)[0]
        for (group, _), rows in zip(_groups(problem.picture), predicted, strict=True)
    ]
    return _equations(problem, state, sums, prediction.by_motion)


def _groups(picture: Picture) -> tuple[tuple[Group, bool], tuple[Group, bool]]:
    """Both groups, and whether they are near lines."""
    return (picture.near_circles, False), (picture.near_lines, True)


class _Sums(NamedTuple):
    """Sums over pixels: of w J^T J with J = (rows, residual), that of each block, and the cost."""

    products: Float[ArrayLike, "k k"]
    of_blocks: Float[ArrayLike, "b 6 l"]
    cost: Float[ArrayLike, ""]


def _sum_pixels(
    problem: PictureProblem,
    state: PictureState,
    group: Group,
    rows: PixelRows | Callable[[Group], PixelRows],
) -> tuple[_Sums, PixelRows]:
    """Sums over a group's pixels, and their rows, which are given or predicted."""
    dtype, single = state.values.dtype, group.pixels.grey.dtype
    count, size = len(group.pixels.grey) // CHUNK, 9 + state.unknowns.size
    chunks = -(-group.chunks // problem.stride)
    # Polynomials hardly differ from local levels: single precision loses the difference.
    precise = dtype if state.levels.size else single
    loss = jax.tree.map(lambda leaf: leaf.astype(single), problem.loss)
    saturation = jax.tree.map(lambda leaf: leaf.astype(single), problem.picture.saturation)

    def add(part: Group, one: PixelRows, sums: _Sums) -> _Sums:
        level, slope = one.level, jnp.ones_like(one.level)
        if not state.unknowns.is_ideal:
            cut = clipped_moments(level, part.pixels.sigma, saturation)
            level, slope = cut.mean, cut.slope
        residual, weight = level - part.pixels.grey, part.pixels.weight
        squared = (weight * residual) ** 2
        # The square root of the weight: rows and residual then share one product.
        root = weight * loss.root_weight(squared)
        weighted = jnp.concatenate([one.rows * (slope * root)[None], (residual * root)[None]])
        weighted, of_blocks = weighted.astype(precise), sums.of_blocks
        if part.local is not None:
            local = local_rows(one.by_local, part.local.basis) * (slope * root)[None]
            local = local.astype(precise)
            products = jnp.einsum("in,jn->nij", local, jnp.concatenate([local, weighted]))
            of_blocks = jnp.asarray(of_blocks).at[part.local.block].add(products)
        return _Sums(
            sums.products + (weighted @ weighted.T).astype(dtype),
            of_blocks,
            sums.cost + jnp.sum(loss.rho(squared)).astype(dtype),
        )

    def part_of(k: Int[ArrayLike, ""]) -> Group:
        return jax.tree.map(partial(_chunk, k), group._replace(chunks=None))

    start = _Sums(
        jnp.zeros((size + 1, size + 1), dtype),
        jnp.zeros((state.levels.shape[1], LOCAL_TERMS, LOCAL_TERMS + size + 1), dtype),
        jnp.zeros((), dtype),
    )
    if isinstance(rows, PixelRows):

        def look_up(k: Int[ArrayLike, ""], sums: _Sums) -> _Sums:
            return add(part_of(k), jax.tree.map(lambda whole: whole[k], rows), sums)

        return jax.lax.fori_loop(0, chunks, look_up, start), rows

    def predict(k: Int[ArrayLike, ""], carry: tuple[_Sums, PixelRows]) -> tuple[_Sums, PixelRows]:
        part = part_of(k)
        one = rows(part)
        stored = jax.tree.map(lambda whole, piece: whole.at[k].set(piece), carry[1], one)
        return add(part, one, carry[0]), stored

    stored = PixelRows(
        level=jnp.zeros((count, CHUNK), single),
        rows=jax.lax.empty((count, size, CHUNK), single),
        by_local=jax.lax.empty((count, 2 if state.levels.size else 0, CHUNK), single),
    )
    return jax.lax.fori_loop(0, chunks, predict, (start, stored))


def _equations(
    problem: PictureProblem,
    state: PictureState,
    sums: list[_Sums],
    by_motion: Float[ArrayLike, "9 p"],
) -> ArrowEquations:
    """Sums of both groups by steps of (pose, values) and of the levels, priors included."""
    # From (homography, values, residual) to (pose, values, residual).
    kept = jnp.eye(state.unknowns.size + 1, dtype=by_motion.dtype)
    chain = jax.scipy.linalg.block_diag(by_motion, kept)
    products = chain.T @ (sums[0].products + sums[1].products) @ chain
    pose = jnp.zeros(problem.model.size)
    prior = problem.picture.prior
    mean, weight = (jnp.concatenate([pose, part]) for part in (prior.mean, prior.weight))
    offset = jnp.concatenate([pose, state.values]) - mean
    of_blocks = sums[0].of_blocks + sums[1].of_blocks
    across = of_blocks[:, :, LOCAL_TERMS:] @ chain
    level_weight, levels = prior.local_weight, jnp.asarray(state.levels).T
    arrow = BlockArrow(
        products[:-1, :-1] + jnp.diag(weight),
        jnp.swapaxes(across[:, :, :-1], 1, 2),
        of_blocks[:, :, :LOCAL_TERMS] + jnp.diag(level_weight)[None],
    )
    gradient = products[:-1, -1] + weight * offset, across[:, :, -1] + level_weight[None] * levels
    prior_cost = weight @ offset**2 + jnp.sum(level_weight[None] * levels**2)
    return ArrowEquations(sums[0].cost + sums[1].cost + prior_cost, arrow, gradient)


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
    """Grey levels before saturation and their derivatives, in the precision of the pixels."""
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
    return PixelRows(level, rows, by_local)


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
