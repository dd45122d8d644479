"""Normal equations of one image: a head (pose and appearance), and blocks (local light).

`predict_image` computes grey levels and derivatives, `weigh_image` the weighted sums. Other noise
or excluded pixels need no new prediction. Pixels are processed in chunks that fit the cache, in the
precision of their arrays (single precision suffices and is twice as fast). Sums have the precision
of the homography. The number of chunks is data: one compiled program serves any number of pixels up
to the length of the padded arrays.
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
from trinoc.calib.photometric.sheet_geometry import sheet_from_camera
from trinoc.calib.photometric.unknowns import (
    LOCAL_TERMS,
    ImagePrior,
    ImageState,
    step_unit_mm,
)
from trinoc.calib.problem.solver import AbstractArrowProblem, ArrowEquations
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.block_arrow import BlockArrow
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.robust_loss import GemanMcClure

CHUNK = 512  # numerical: number of pixels in a chunk


class LocalPixels(NamedTuple):
    """Block of each pixel, and (1, x, y) relative to the centre of the block, in half pitches."""

    block: Int[ArrayLike, "n"]
    basis: Float[ArrayLike, "n 3"]


class Group(NamedTuple):
    """Pixels with the same model: those near circles only, or those near a line.

    Fields
    ------
    pixels : the pixels, padded to complete chunks.
    chunks : number of chunks that are used.
    local : block of each pixel if blocks have their own light, else None.
    """

    pixels: Pixels
    chunks: Int[ArrayLike, ""]
    local: LocalPixels | None = None


class ImageData(NamedTuple):
    """Data of one image for the compiled programs: pixels, constants and priors.

    Fields
    ------
    near_circles, near_lines : the two groups of pixels.
    cross : the crossed lines of the sheet.
    white : grey level of a full signal.
    saturation : saturation level.
    prior : prior of the unknowns other than the pose.
    """

    near_circles: Group
    near_lines: Group
    cross: Cross
    white: Float[ArrayLike, ""]
    saturation: Saturation
    prior: ImagePrior


class PixelRows(NamedTuple):
    """Predicted grey levels before saturation, and their derivatives.

    For a group of pixels, the leading axis counts the chunks, padding included.

    Fields
    ------
    level : (n,) grey levels.
    rows : (9 + k, n) derivatives by the homography and by the unknowns other than the pose.
    by_local : (2, n) derivatives by the light and the veil of the pixel's block; (0, n) without
        local light.
    """

    level: Float[ArrayLike, "*c n"]
    rows: Float[ArrayLike, "*c k n"]
    by_local: Float[ArrayLike, "*c l n"]


class Prediction(NamedTuple):
    """Predicted pixels of both groups, and the derivative (9, p) of the homography by the pose."""

    near_circles: PixelRows
    near_lines: PixelRows
    by_motion: Float[ArrayLike, "9 p"]


class ImageProblem(AbstractArrowProblem[ImageState]):
    """Least-squares problem of one image. The head is (pose, values); each block has local levels.

    Fields
    ------
    image : pixels with their noise, and priors.
    loss : robust loss, which saturates at a squared residual in sigmas; infinite for least squares.
    free : (k,) 1 for each estimated unknown of the head, else 0.
    stride : only the first 1/stride of each group's chunks is used.
    drawing : properties of the sheet.
    model : parameters of the pose that a step may change.
    """

    image: ImageData
    loss: GemanMcClure
    free: Float[ArrayLike, "k"]
    stride: Int[ArrayLike, ""]
    drawing: InkDrawing = eqx.field(static=True)
    model: PoseModel = eqx.field(static=True)

    def equations(self, state: ImageState) -> ArrowEquations:
        """Equations of the estimated unknowns.

        Their `details` are the equations of all unknowns, whose `details` are the prediction.
        """
        all_equations = predict_image(self, state)
        return self.remove_fixed(all_equations)._replace(details=all_equations)

    def remove_fixed(self, equations: ArrowEquations) -> ArrowEquations:
        """Set the rows and columns of fixed unknowns to zero."""
        arrow, (of_head, of_blocks), free = equations.information, equations.gradient, self.free
        head = arrow.head * free[:, None] * free[None]
        arrow = BlockArrow(head, arrow.coupling * free[None, :, None], arrow.blocks)
        return ArrowEquations(equations.cost, arrow, (of_head * free, of_blocks))

    def retract(
        self, state: ImageState, head: Float[ArrayLike, "k"], blocks: Float[ArrayLike, "b 6"]
    ) -> ImageState:
        """State after a step, clipped to the bounds of the unknowns."""
        return state.move(head, state.levels + blocks.T, self.model)


def predict_image(problem: ImageProblem, state: ImageState) -> ArrowEquations:
    """Equations of all unknowns at a state; their `details` are the prediction."""
    homography, by_motion = homography_and_slope(state, problem.model)
    sums, rows = [], []
    for group, near_line in _groups(problem.image):

        def predict(part: Group, near_line: bool = near_line) -> PixelRows:
            image, drawing = problem.image, problem.drawing
            return pixel_rows(homography, state, part, image, drawing, near_line)

        group_sums, predicted = _sum_pixels(problem, state, group, predict)
        sums.append(group_sums)
        rows.append(predicted)
    prediction = Prediction(rows[0], rows[1], by_motion)
    return _equations(problem, state, sums, by_motion)._replace(details=prediction)


def weigh_image(problem: ImageProblem, state: ImageState, prediction: Prediction) -> ArrowEquations:
    """Equations of all unknowns at a state, from an existing prediction."""
    predicted = prediction.near_circles, prediction.near_lines
    sums = [
        _sum_pixels(problem, state, group, rows)[0]
        for (group, _), rows in zip(_groups(problem.image), predicted, strict=True)
    ]
    return _equations(problem, state, sums, prediction.by_motion)


def _groups(image: ImageData) -> tuple[tuple[Group, bool], tuple[Group, bool]]:
    """Both groups of pixels, each with a flag: True for pixels near lines."""
    return (image.near_circles, False), (image.near_lines, True)


class _Sums(NamedTuple):
    """Sums over pixels: w J^T J with J = (rows, residual), the same by blocks, and the cost."""

    products: Float[ArrayLike, "k k"]
    of_blocks: Float[ArrayLike, "b 6 l"]
    cost: Float[ArrayLike, ""]


def _sum_pixels(
    problem: ImageProblem,
    state: ImageState,
    group: Group,
    rows: PixelRows | Callable[[Group], PixelRows],
) -> tuple[_Sums, PixelRows]:
    """Sums over the pixels of a group, and their predictions.

    rows : existing predictions, or a function that computes them for a chunk.
    """
    dtype, single = state.values.dtype, group.pixels.grey.dtype
    count, size = len(group.pixels.grey) // CHUNK, 9 + state.unknowns.size
    chunks = -(-group.chunks // problem.stride)
    # Polynomials and local levels are nearly collinear: single precision is not sufficient.
    precise = dtype if state.levels.size else single
    loss = jax.tree.map(lambda leaf: leaf.astype(single), problem.loss)
    saturation = jax.tree.map(lambda leaf: leaf.astype(single), problem.image.saturation)

    def add(part: Group, predicted: PixelRows, sums: _Sums) -> _Sums:
        level, slope = predicted.level, jnp.ones_like(predicted.level)
        if not state.unknowns.is_ideal:
            clipped = clipped_moments(level, part.pixels.sigma, saturation)
            level, slope = clipped.mean, clipped.slope
        residual, weight = level - part.pixels.grey, part.pixels.weight
        squared = (weight * residual) ** 2
        # With the square root of the weight, one product serves rows and residual.
        root = weight * loss.root_weight(squared)
        weighted = jnp.concatenate([predicted.rows * (slope * root)[None], (residual * root)[None]])
        weighted, of_blocks = weighted.astype(precise), sums.of_blocks
        if part.local is not None:
            local = local_rows(predicted.by_local, part.local.basis) * (slope * root)[None]
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
            return add(part_of(k), jax.tree.map(lambda leaf: leaf[k], rows), sums)

        return jax.lax.fori_loop(0, chunks, look_up, start), rows

    def predict(k: Int[ArrayLike, ""], carry: tuple[_Sums, PixelRows]) -> tuple[_Sums, PixelRows]:
        part = part_of(k)
        predicted = rows(part)
        stored = jax.tree.map(lambda leaf, piece: leaf.at[k].set(piece), carry[1], predicted)
        return add(part, predicted, carry[0]), stored

    stored = PixelRows(
        level=jnp.zeros((count, CHUNK), single),
        rows=jax.lax.empty((count, size, CHUNK), single),
        by_local=jax.lax.empty((count, 2 if state.levels.size else 0, CHUNK), single),
    )
    return jax.lax.fori_loop(0, chunks, predict, (start, stored))


def _equations(
    problem: ImageProblem,
    state: ImageState,
    sums: list[_Sums],
    by_motion: Float[ArrayLike, "9 p"],
) -> ArrowEquations:
    """Equations for steps of (pose, values) and of the local levels, with priors.

    sums : sums of both groups, by the homography instead of the pose.
    """
    # From (homography, values, residual) to (pose, values, residual).
    identity = jnp.eye(state.unknowns.size + 1, dtype=by_motion.dtype)
    chain = jax.scipy.linalg.block_diag(by_motion, identity)
    products = chain.T @ (sums[0].products + sums[1].products) @ chain
    pose = jnp.zeros(problem.model.size)
    prior = problem.image.prior
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
    state: ImageState, model: PoseModel
) -> tuple[Float[ArrayLike, "3 3"], Float[ArrayLike, "9 p"]]:
    """Homography from the camera to the sheet, and its derivative by a step of the pose."""
    pose = state.pose

    def after(motion: Float[ArrayLike, "p"]) -> Float[ArrayLike, "9"]:
        moved = pose.retract(motion, model, step_unit_mm(pose, model))
        return sheet_from_camera(moved).reshape(9)

    zero = jnp.zeros(model.size, jnp.asarray(pose.rotation).dtype)
    return after(zero).reshape(3, 3), jax.jacfwd(after)(zero)


def local_rows(
    by_local: Float[ArrayLike, "2 n"], basis: Float[ArrayLike, "n 3"]
) -> Float[ArrayLike, "6 n"]:
    """Derivatives of each pixel's grey level by the six local levels of its block."""
    return (by_local[:, None] * basis.T[None]).reshape(LOCAL_TERMS, -1)


def pixel_rows(
    homography: Float[ArrayLike, "3 3"],
    state: ImageState,
    group: Group,
    image: ImageData,
    drawing: InkDrawing,
    near_line: bool,
) -> PixelRows:
    """Predicted grey levels before saturation, and their derivatives, in the pixels' float type.

    near_line : True for pixels near a line. They are modelled with lines and circles, the others
    with circles only.
    """
    pixels, unknowns = group.pixels, state.unknowns
    single = pixels.grey.dtype
    shared = homography, state, image.cross, image.white
    plane, rounded, cross, white = jax.tree.map(lambda leaf: jnp.asarray(leaf, single), shared)
    terms = light_terms(pixels.position.T, max(unknowns.light_terms, unknowns.veil_terms))
    light_basis, veil_basis = terms[: unknowns.light_terms], terms[: unknowns.veil_terms]
    polynomial, veil = rounded.light @ light_basis, rounded.veil @ veil_basis
    light, factor = polynomial, jnp.ones_like(polynomial)
    if group.local is not None:
        levels, basis = rounded.levels[:, group.local.block], group.local.basis.T
        factor = 1 + jnp.sum(levels[:3] * basis, axis=0)
        light, veil = polynomial * factor, veil + jnp.sum(levels[3:] * basis, axis=0)
    predicted = predict_levels(
        plane, rounded, light, veil, pixels, cross, white, drawing, near_line
    )
    rows = jnp.concatenate(
        [
            jnp.stack([*predicted.by_homography, *predicted.by_appearance]),
            (predicted.by_light * factor)[None] * light_basis,
            predicted.by_veil[None] * veil_basis,
        ]
    )
    by_local = jnp.stack([predicted.by_light * polynomial, predicted.by_veil])
    by_local = by_local[: 2 if group.local else 0]
    # Rounding of the homography and the appearance to the pixels' precision affects all pixels
    # alike. In a large image this error exceeds the noise: correct it to first order.
    exact = jnp.concatenate([homography.reshape(9), state.values[: len(unknowns.appearance)]])
    rounding = (exact - exact.astype(single).astype(exact.dtype)).astype(single)
    # Divisions by one: see `SheetPoint.unit`.
    rows, by_local = rows / pixels.unit[None], by_local / pixels.unit[None]
    level = predicted.level + rounding @ rows[: len(rounding)]
    return PixelRows(level, rows, by_local)


def light_terms(position: Float[ArrayLike, "2 n"], count: int) -> Float[ArrayLike, "m n"]:
    """First `count` monomials of a polynomial in (x, y), lower degrees first."""
    x, y = position
    math = array_namespace(position)
    degree, terms = [math.ones_like(x)], [math.ones_like(x)]
    while len(terms) < count:
        degree = [*(term * x for term in degree), degree[-1] * y]
        terms += degree
    return math.stack(terms[:count])


def _chunk(k: Int[ArrayLike, ""], leaf: ArrayLike) -> ArrayLike:
    return jax.lax.dynamic_slice_in_dim(leaf, k * CHUNK, CHUNK, allow_negative_indices=False)
