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
    """Assignment of pixels to the blocks of the sheet that have their own light.

    Attributes
    ----------
    block : (n,) index of each pixel's block.
    basis : (n, 3) values 1, x, y of each pixel; x and y are relative to the block's centre, in
        halves of the distance between block centres.
    """

    block: Int[ArrayLike, "n"]
    basis: Float[ArrayLike, "n 3"]


class Group(NamedTuple):
    """Pixels with the same model: those near circles only, or those near a line.

    Attributes
    ----------
    pixels : the pixels, padded to complete chunks of `CHUNK` pixels.
    chunks : number of chunks with pixels that are not padding.
    local : block of each pixel if blocks have their own light, else None.
    """

    pixels: Pixels
    chunks: Int[ArrayLike, ""]
    local: LocalPixels | None = None


class ImageData(NamedTuple):
    """Pixels, constants and priors of one image, as arguments of the compiled programs.

    Attributes
    ----------
    near_circles, near_lines : pixels near circles only, and pixels near a crossed line.
    cross : the crossed lines of the sheet.
    white : grey level of a full signal.
    saturation : saturation level, and the noise assumed for clipped pixels.
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

    The arrays of a whole group have one more axis in front, which counts the chunks.

    Attributes
    ----------
    level : (n,) grey levels.
    rows : (9 + k, n) derivatives with respect to the 9 elements of the sheet-from-camera homography
        and the k unknowns other than the pose.
    by_local : (2, n) derivatives with respect to the light and the veil (additional light on paper
        and ink alike) of the pixel's block; (0, n) if blocks do not have their own light.
    """

    level: Float[ArrayLike, "*c n"]
    rows: Float[ArrayLike, "*c k n"]
    by_local: Float[ArrayLike, "*c l n"]


class Prediction(NamedTuple):
    """Predicted grey levels of one image, with derivatives.

    Attributes
    ----------
    near_circles, near_lines : predictions of both groups of pixels.
    by_motion : (9, p) derivative of the sheet-from-camera homography with respect to a step of the
        pose.
    """

    near_circles: PixelRows
    near_lines: PixelRows
    by_motion: Float[ArrayLike, "9 p"]


class ImageProblem(AbstractArrowProblem[ImageState]):
    """Least-squares problem of the grey levels of one image.

    The normal equations are a block arrow. Its head consists of the pose and the other unknowns of
    the whole image. Each block consists of the six parameters of the local light of one block of
    the sheet.

    Attributes
    ----------
    image : pixels with their noise, constants and priors.
    loss : robust loss of Geman and McClure of the squared normalised residual; an infinite scale
        gives least squares.
    free : (k,) 1 for each unknown of the head that is estimated, else 0.
    stride : the sums use the first 1/stride of the chunks of each group.
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
        """Normal equations of the estimated unknowns at a state.

        `details` of the result contains the equations of all unknowns, including fixed ones. The
        `details` of those equations is the `Prediction`.
        """
        all_equations = predict_image(self, state)
        return self.remove_fixed(all_equations)._replace(details=all_equations)

    def remove_fixed(self, equations: ArrowEquations) -> ArrowEquations:
        """Copy of the equations in which the rows and columns of fixed unknowns are zero."""
        arrow, (of_head, of_blocks), free = equations.information, equations.gradient, self.free
        head = arrow.head * free[:, None] * free[None]
        arrow = BlockArrow(head, arrow.coupling * free[None, :, None], arrow.blocks)
        return ArrowEquations(equations.cost, arrow, (of_head * free, of_blocks))

    def retract(
        self, state: ImageState, head: Float[ArrayLike, "k"], blocks: Float[ArrayLike, "b 6"]
    ) -> ImageState:
        """State after a step, clipped to the bounds of the unknowns.

        Parameters
        ----------
        state : state before the step.
        head : (k,) step of the pose and the other unknowns of the image.
        blocks : (b, 6) step of the local light of each block.
        """
        return state.move(head, state.levels + blocks.T, self.model)


def predict_image(problem: ImageProblem, state: ImageState) -> ArrowEquations:
    """Predict all pixels, and build the normal equations of all unknowns.

    `details` of the result is the `Prediction`.
    """
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
    """Build the normal equations of all unknowns from an existing prediction.

    This is sufficient if only weights or noise have changed since the prediction at the same state.
    """
    predicted = prediction.near_circles, prediction.near_lines
    sums = [
        _sum_pixels(problem, state, group, rows)[0]
        for (group, _), rows in zip(_groups(problem.image), predicted, strict=True)
    ]
    return _equations(problem, state, sums, prediction.by_motion)


def _groups(image: ImageData) -> tuple[tuple[Group, bool], tuple[Group, bool]]:
    """Both groups of pixels, each with a flag that is True for the pixels near lines."""
    return (image.near_circles, False), (image.near_lines, True)


class _Sums(NamedTuple):
    """Weighted sums over pixels for the normal equations.

    J contains the derivatives of a pixel with respect to the homography and to the other unknowns,
    and its residual.

    Attributes
    ----------
    products : sum of w J^T J, with k columns in J.
    of_blocks : per block, sum of w L^T (L, J), where L contains the derivatives with respect to the
        block's six local levels (see `local_rows`).
    cost : sum of the robust loss.
    """

    products: Float[ArrayLike, "k k"]
    of_blocks: Float[ArrayLike, "b 6 l"]
    cost: Float[ArrayLike, ""]


def _sum_pixels(
    problem: ImageProblem,
    state: ImageState,
    group: Group,
    rows: PixelRows | Callable[[Group], PixelRows],
) -> tuple[_Sums, PixelRows]:
    """Weighted sums over the pixels of a group, and the predictions of these pixels.

    rows : existing predictions, or a function that computes the predictions of a chunk.
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
    """Normal equations for steps of the pose, the other unknowns and the local levels, with priors.

    sums : sums of both groups of pixels. Their derivatives are with respect to the homography and
        are converted here to derivatives with respect to the pose.
    by_motion : derivative of the homography with respect to a step of the pose.
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
    """Homography from the camera to the sheet, and its derivative with respect to the pose.

    Lengths in a step of the pose are in units of `step_unit_mm`.

    Returns
    -------
    (3, 3) homography, and (9, p) derivatives of its elements.
    """
    pose = state.pose

    def after(motion: Float[ArrayLike, "p"]) -> Float[ArrayLike, "9"]:
        moved = pose.retract(motion, model, step_unit_mm(pose, model))
        return sheet_from_camera(moved).reshape(9)

    zero = jnp.zeros(model.size, jnp.asarray(pose.rotation).dtype)
    return after(zero).reshape(3, 3), jax.jacfwd(after)(zero)


def local_rows(
    by_local: Float[ArrayLike, "2 n"], basis: Float[ArrayLike, "n 3"]
) -> Float[ArrayLike, "6 n"]:
    """Derivatives of each pixel's grey level with respect to the six local levels of its block.

    The local levels are the coefficients of 1, x, y of the block's light and of its veil.

    Parameters
    ----------
    by_local : (2, n) derivatives with respect to the local light and the local veil at the pixel.
    basis : (n, 3) values 1, x, y of each pixel in its block; see `LocalPixels`.
    """
    return (by_local[:, None] * basis.T[None]).reshape(LOCAL_TERMS, -1)


def pixel_rows(
    homography: Float[ArrayLike, "3 3"],
    state: ImageState,
    group: Group,
    image: ImageData,
    drawing: InkDrawing,
    near_line: bool,
) -> PixelRows:
    """Predict grey levels before saturation, with derivatives.

    The results have the precision of the pixel arrays.

    Parameters
    ----------
    homography : (3, 3) homography from rays in the camera frame to the sheet.
    state : values of the unknowns.
    group : the pixels.
    image : constants of the image.
    drawing : properties of the sheet.
    near_line : True for pixels near a line, whose model contains lines and circles. The model of
        other pixels contains circles only.
    """
    pixels, unknowns = group.pixels, state.unknowns
    single = pixels.grey.dtype
    arguments = homography, state, image.cross, image.white
    plane, rounded, cross, white = jax.tree.map(lambda leaf: jnp.asarray(leaf, single), arguments)
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
    """First `count` monomials of (x, y), (count, n), in the order 1, x, y, x^2, x y, y^2, ...

    Parameters
    ----------
    position : (2, n) values x and y.
    count : number of monomials.
    """
    x, y = position
    math = array_namespace(position)
    degree, terms = [math.ones_like(x)], [math.ones_like(x)]
    while len(terms) < count:
        degree = [*(term * x for term in degree), degree[-1] * y]
        terms += degree
    return math.stack(terms[:count])


def _chunk(k: Int[ArrayLike, ""], leaf: ArrayLike) -> ArrayLike:
    return jax.lax.dynamic_slice_in_dim(leaf, k * CHUNK, CHUNK, allow_negative_indices=False)
