"""Where the picture shows each circle and each piece of the crossed lines.

At the end of the fit a patch of the sheet may still be displaced in the picture, because paper
bends or the lens is another than was said. The grey levels tell by how much, all patches sharing
one appearance: normal equations in the displacements, from which the appearance is eliminated.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from trinoc.calib.photometric.equations import local_rows
from trinoc.calib.photometric.fit_state import PictureFitState
from trinoc.calib.photometric.scene import PixelScene
from trinoc.calib.photometric.sheet_places import homography_of_pose
from trinoc.calib.photometric.unknowns import LOCAL_TERMS, PicturePrior
from trinoc.calib.problem.views import LINE_PIECES, SheetPoints
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

# numerical: a guard: a direction that a patch shows with less than this share of the information of
# its best one, as a line along itself, is not known; nor is a patch with less than this share of
# the best patch's, as a single pixel in a lamp's glare.
_LEAST_SHARE = 1e-3
# numerical: no patches.
_NOTHING = SheetPoints(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0)))


class _SharedUnknowns(NamedTuple):
    """What patches share: look, light and veil; where light is local, also its levels.

    Fields
    ------
    rows : (n, q) derivatives of all pixels by what all patches share.
    by_levels : (n, l) by the levels of every block, most of them zero; no columns without.
    prior, pull : (q + l,) information of the priors, and its gradient.
    """

    rows: Float[np.ndarray, "n q"]
    by_levels: scipy.sparse.csr_matrix
    prior: Float[np.ndarray, "m"]
    pull: Float[np.ndarray, "m"]


def patch_points(
    lens: AbstractLens,
    pattern: Pattern | SquareSheet,
    scene: PixelScene,
    point: PictureFitState,
    inflation: float,
) -> SheetPoints:
    """The patches that a picture shows; none where the fit has left all that is finite.

    inflation : of variances over those of independent noise as large as was assumed.
    """
    rays = [group.pixels.ray for group in scene.groups]
    direction = scene.join_pixels([ray.direction for ray in rays]).astype(float)
    by_pixel = scene.join_pixels([ray.by_pixel for ray in rays])
    homography = np.asarray(homography_of_pose(point.state.pose))
    on_sheet = homography @ direction.T
    place = (on_sheet[:2] / on_sheet[2]).T
    all_rows = point.rows(scene)
    # A picture that is shifted by d shows at x what it showed at x - d. The third column of the
    # homography acts by the third coordinate of the ray.
    by_direction = -homography.T @ (all_rows[2:9:3] / direction[:, 2])
    by_px = np.einsum("jn,njk->kn", by_direction, by_pixel)
    residual, sigma = point.residual(scene)
    # Neighbours share noise, and it is not all that the levels say: as the pose knows of it.
    weight = point.kept * sigma**-2 / inflation
    if not all(np.isfinite(part).all() for part in (place, weight, all_rows)):
        return _NOTHING
    near_line = np.arange(len(scene.grey)) >= scene.counts[0]
    label = np.where(near_line, -1, scene.chosen.circle)
    if isinstance(pattern, Pattern):
        piece = len(pattern) + _piece_of_line(place, pattern)
        label = np.where(label >= 0, label, piece)
    known = (by_px**2).sum(axis=0) * weight
    label, known = _number_patches(label, known)
    by_px = by_px * (known > 0)
    total = np.bincount(label, known)
    middle = np.stack([np.bincount(label, known * axis) / total for axis in place.T], axis=1)
    try:
        shared = _shared_unknowns(scene, point, all_rows[9:], inflation)
        shift, whitening = _displacements(by_px, label, len(total), residual, weight, shared)
    except np.linalg.LinAlgError:
        return _NOTHING
    shown = np.asarray(_images(lens, np.linalg.inv(homography), middle))
    return SheetPoints(middle, shown + shift, whitening)


@kept_jit
def _images(
    lens: AbstractLens,
    camera_from_sheet: Float[ArrayLike, "3 3"],
    places_mm: Float[ArrayLike, "m 2"],
) -> Float[ArrayLike, "m 2"]:
    def image(place: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        return lens.project_ray(camera_from_sheet @ jnp.append(place, 1.0))

    return jax.vmap(image)(places_mm)


def _piece_of_line(place_mm: Float[np.ndarray, "n 2"], pattern: Pattern) -> Int[np.ndarray, "n"]:
    """The piece of a line that each place is on: of the line along X, then of the one along Y."""
    x, y = place_mm.T
    along_y = np.abs(y) > np.abs(x)
    reach = np.where(along_y, pattern.line_half_length_mm[1], pattern.line_half_length_mm[0])
    along = np.where(along_y, y, x) / np.maximum(reach, 1e-9)
    last = 2 * LINE_PIECES - 1
    return np.clip(np.floor((along + 1) * LINE_PIECES), 0, last).astype(int) + along_y * (last + 1)


def _number_patches(
    label: Int[np.ndarray, "n"], known: Float[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Patches of which something is known numbered from 0; pixels of others, which show nothing,
    count to the first."""
    total = np.bincount(label, known)
    is_useful = total > _LEAST_SHARE * total.max()
    number = np.where(is_useful, np.cumsum(is_useful) - 1, 0)
    return number[label], known * is_useful[label]


def _shared_unknowns(
    scene: PixelScene, point: PictureFitState, by_values: Float[np.ndarray, "k n"], inflation: float
) -> _SharedUnknowns:
    """Light about a patch, where it has its own, can do what a displacement does."""
    state, free = point.state, point.free[scene.model.size :]
    prior = state.unknowns.prior(scene.tuning, local=scene.local)
    weight = np.asarray(prior.weight)
    pull = weight * (state.values - prior.mean)
    by_levels, level_weight, level_pull = _local_light(scene, point, prior)
    # Priors count as the pixels do: together they balance where the fit has ended.
    return _SharedUnknowns(
        by_values[free].astype(float).T,
        by_levels,
        np.concatenate([weight[free], level_weight]) / inflation,
        np.concatenate([pull[free], level_pull]) / inflation,
    )


def _local_light(
    scene: PixelScene, point: PictureFitState, prior: PicturePrior
) -> tuple[scipy.sparse.csr_matrix, Float[np.ndarray, "l"], Float[np.ndarray, "l"]]:
    """Derivatives by every block's levels, and the information and gradient of their priors."""
    count, blocks = len(point.kept), scene.blocks
    if not scene.local or blocks is None:
        return scipy.sparse.csr_matrix((count, 0)), np.zeros(0), np.zeros(0)
    rows = local_rows(point.rows_by_local(scene), blocks.basis).astype(float)
    column = LOCAL_TERMS * blocks.of_pixel + np.arange(LOCAL_TERMS)[:, None]
    row = np.tile(np.arange(count), LOCAL_TERMS)
    size = (count, LOCAL_TERMS * blocks.count)
    weight = np.tile(prior.local_weight, blocks.count)
    levels = np.asarray(point.state.levels).T.ravel()
    return (
        scipy.sparse.csr_matrix((rows.ravel(), (row, column.ravel())), size),
        weight,
        weight * levels,
    )


def _displacements(
    by_px: Float[np.ndarray, "2 n"],
    patch: Int[np.ndarray, "n"],
    count: int,
    residual: Float[np.ndarray, "n"],
    weight: Float[np.ndarray, "n"],
    shared: _SharedUnknowns,
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "q q"]]:
    """Shift of each patch in px, and R of all their errors, what they share being eliminated."""
    rows, by_levels, weighted = shared.rows, shared.by_levels, by_px * weight

    def of_patches(values: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "m k"]:
        """Weighted sums over the pixels of each patch of by_u and by_v times values."""
        sums = [[np.bincount(patch, axis * row, count) for row in values] for axis in weighted]
        return np.array(sums).transpose(2, 0, 1).reshape(2 * count, len(values))

    across = np.concatenate(
        [of_patches(rows.T), _sums_with_levels(weighted, patch, count, by_levels)], axis=1
    )
    by_weight, levels_by_weight = (rows * weight[:, None]).T, by_levels.multiply(weight[:, None]).T
    corner = levels_by_weight @ rows
    inner = np.block(
        [[by_weight @ rows, corner.T], [corner, (levels_by_weight @ by_levels).toarray()]]
    ) + np.diag(shared.prior)
    pull = np.concatenate([by_weight @ residual, levels_by_weight @ residual]) + shared.pull
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    eliminated = (across / scale) @ np.linalg.pinv(inner / np.outer(scale, scale), hermitian=True)
    each = of_patches(by_px).reshape(count, 2, 2)
    alone = np.zeros((count, 2, count, 2))
    alone[np.arange(count), :, np.arange(count)] = each
    information = alone.reshape(2 * count, 2 * count) - eliminated @ (across / scale).T
    slope = of_patches(residual[None])[:, 0] - eliminated @ (pull / scale)
    known = _known_directions(each)
    factor = np.linalg.cholesky(known.T @ information @ known)
    step = np.linalg.solve(factor.T, np.linalg.solve(factor, known.T @ slope))
    whitening = np.zeros((2 * count, 2 * count))
    whitening[: known.shape[1]] = factor.T @ known.T
    return -(known @ step).reshape(count, 2), whitening


def _sums_with_levels(
    weighted: Float[np.ndarray, "2 n"],
    patch: Int[np.ndarray, "n"],
    count: int,
    by_levels: scipy.sparse.csr_matrix,
) -> Float[np.ndarray, "m l"]:
    """Sums over the pixels of each patch of `weighted` times the derivatives by levels."""
    if not by_levels.shape[1]:  # pyright: ignore[reportOptionalSubscript]
        return np.zeros((2 * count, 0))
    pixel, column = np.tile(np.arange(len(patch)), 2), np.concatenate([2 * patch, 2 * patch + 1])
    by_patch = scipy.sparse.csr_matrix((weighted.ravel(), (column, pixel)), (2 * count, len(patch)))
    return scipy.sparse.csr_matrix(by_patch @ by_levels).toarray()


def _known_directions(information: Float[np.ndarray, "c 2 2"]) -> Float[np.ndarray, "k q"]:
    """Unit vectors along which patches are known by themselves."""
    count = len(information)
    values, vectors = np.linalg.eigh(information)
    basis = np.zeros((count, 2, count, 2))
    basis[np.arange(count), :, np.arange(count)] = vectors
    is_known = values > _LEAST_SHARE * values[:, 1:]
    return basis.reshape(2 * count, 2 * count)[:, is_known.ravel()]
