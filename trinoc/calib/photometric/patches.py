"""Image positions of patches of the sheet: circles and pieces of the crossed lines.

After the fit, patches may still be displaced in the image, because the paper is bent or the lens
differs from the given one. Their displacements are estimated from the grey levels. All patches
share one appearance, which is eliminated from the normal equations.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float, Int

from trinoc.calib.photometric.equations import local_rows
from trinoc.calib.photometric.fit_state import ImageFitState
from trinoc.calib.photometric.scene import PixelScene
from trinoc.calib.photometric.sheet_geometry import homography_of_pose
from trinoc.calib.photometric.unknowns import LOCAL_TERMS, ImagePrior
from trinoc.calib.problem.views import LINE_PIECES, SheetPoints
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

# numerical: a displacement is not determined along a direction with less than this share of the
# information of the patch's best direction, such as along a line. A patch with less than this share
# of the best patch's information is not used.
_LEAST_SHARE = 1e-3
# numerical: no patches.
_NO_POINTS = SheetPoints(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0)))


class _SharedUnknowns(NamedTuple):
    """Derivatives and priors of the unknowns that all patches of one image share.

    These unknowns are blur, ink, response, light, veil (additional light on paper and ink alike),
    and the local levels (light and veil of each block of the sheet) if they are estimated.

    Attributes
    ----------
    rows : (n, q) derivatives of the n pixels with respect to the q shared unknowns of the whole
        image.
    by_levels : (n, l) sparse derivatives with respect to the local levels of all blocks; l = 0
        without local light.
    prior : (q + l,) reciprocal variances of the priors.
    prior_gradient : (q + l,) gradient of the priors' cost.
    """

    rows: Float[np.ndarray, "n q"]
    by_levels: "scipy.sparse.csr_matrix"
    prior: Float[np.ndarray, "m"]
    prior_gradient: Float[np.ndarray, "m"]


def patch_points(
    lens: AbstractLens,
    pattern: Pattern | SquareSheet,
    scene: PixelScene,
    fit_state: ImageFitState,
    inflation: float,
) -> SheetPoints:
    """Measure the image positions of all visible patches of the sheet.

    A patch is a circle or a piece of the crossed lines.

    Parameters
    ----------
    lens : the lens.
    pattern : the sheet, or the raster of a board of squares.
    scene, fit_state : pixels and constants of the fit, and its end.
    inflation : variance of the noise divided by that of independent noise with the assumed sigmas.

    Returns
    -------
    Positions on the sheet and in the image, with one whitening matrix for all; no points if the fit
    diverged.
    """
    rays = [group.pixels.ray for group in scene.groups]
    direction = scene.join_pixels([ray.direction for ray in rays]).astype(float)
    by_pixel = scene.join_pixels([ray.by_pixel for ray in rays])
    homography = np.asarray(homography_of_pose(fit_state.state.pose))
    on_sheet = homography @ direction.T
    point_mm = (on_sheet[:2] / on_sheet[2]).T
    all_rows = fit_state.rows(scene)
    # After a displacement d, the image at x is the previous image at x - d. The third column of the
    # homography multiplies the third coordinate of the ray.
    by_direction = -homography.T @ (all_rows[2:9:3] / direction[:, 2])
    by_px = np.einsum("jn,njk->kn", by_direction, by_pixel)
    residual, sigma = fit_state.residual(scene)
    # The inflation by correlated noise is the same as for the pose.
    weight = fit_state.inliers * sigma**-2 / inflation
    if not all(np.isfinite(part).all() for part in (point_mm, weight, all_rows)):
        return _NO_POINTS
    near_line = np.arange(len(scene.grey)) >= scene.counts[0]
    label = np.where(near_line, -1, scene.pixels.circle)
    if isinstance(pattern, Pattern):
        piece = len(pattern) + _piece_of_line(point_mm, pattern)
        label = np.where(label >= 0, label, piece)
    information = (by_px**2).sum(axis=0) * weight
    label, information = _renumber_patches(label, information)
    by_px = by_px * (information > 0)
    total = np.bincount(label, information)
    centroid_mm = np.stack(
        [np.bincount(label, information * axis) / total for axis in point_mm.T], axis=1
    )
    try:
        shared = _shared_unknowns(scene, fit_state, all_rows[9:], inflation)
        shift, whitening = _displacements(by_px, label, len(total), residual, weight, shared)
    except np.linalg.LinAlgError:
        return _NO_POINTS
    predicted_px = np.asarray(_project(lens, np.linalg.inv(homography), centroid_mm))
    return SheetPoints(centroid_mm, predicted_px + shift, whitening)


@kept_jit
def _project(
    lens: AbstractLens,
    camera_from_sheet: Float[ArrayLike, "3 3"],
    points_mm: Float[ArrayLike, "m 2"],
) -> Float[ArrayLike, "m 2"]:
    def project(point_mm: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        return lens.project_ray(camera_from_sheet @ jnp.append(point_mm, 1.0))

    return jax.vmap(project)(points_mm)


def _piece_of_line(point_mm: Float[np.ndarray, "n 2"], pattern: Pattern) -> Int[np.ndarray, "n"]:
    """Index of the piece of the crossed lines nearest to each point.

    The pieces of the line along X come first, in the order of their coordinates.
    """
    x, y = point_mm.T
    along_y = np.abs(y) > np.abs(x)
    reach = np.where(along_y, pattern.line_half_length_mm[1], pattern.line_half_length_mm[0])
    along = np.where(along_y, y, x) / np.maximum(reach, 1e-9)
    last = 2 * LINE_PIECES - 1
    return np.clip(np.floor((along + 1) * LINE_PIECES), 0, last).astype(int) + along_y * (last + 1)


def _renumber_patches(
    label: Int[np.ndarray, "n"], information: Float[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Drop the patches that the pixels hardly locate, and number the others consecutively from 0.

    Parameters
    ----------
    label : (n,) patch index of each pixel.
    information : (n,) information of each pixel on the displacement of its patch, 1/px^2.

    Returns
    -------
    (n,) new patch index, and (n,) information of each pixel; both are 0 for the pixels of a dropped
    patch.
    """
    total = np.bincount(label, information)
    is_useful = total > _LEAST_SHARE * total.max()
    index = np.where(is_useful, np.cumsum(is_useful) - 1, 0)
    return index[label], information * is_useful[label]


def _shared_unknowns(
    scene: PixelScene,
    fit_state: ImageFitState,
    by_values: Float[np.ndarray, "k n"],
    inflation: float,
) -> _SharedUnknowns:
    """Derivatives and priors of the shared unknowns at the end of the fit.

    Local light must be included, because its effects are similar to those of a displacement.

    by_values : (k, n) derivatives of the pixels with respect to all unknowns of the image.
    inflation : factor by which the correlation of the noise increases variances.
    """
    state, free = fit_state.state, fit_state.free[scene.model.size :]
    prior = state.unknowns.prior(scene.tuning, local=scene.has_local_light)
    weight = np.asarray(prior.weight)
    prior_gradient = weight * (state.values - prior.mean)
    by_levels, level_weight, level_gradient = _local_light(scene, fit_state, prior)
    # Priors are scaled like the pixels: at the end of the fit, their gradients balance.
    return _SharedUnknowns(
        by_values[free].astype(float).T,
        by_levels,
        np.concatenate([weight[free], level_weight]) / inflation,
        np.concatenate([prior_gradient[free], level_gradient]) / inflation,
    )


def _local_light(
    scene: PixelScene, fit_state: ImageFitState, prior: ImagePrior
) -> tuple["scipy.sparse.csr_matrix", Float[np.ndarray, "l"], Float[np.ndarray, "l"]]:
    """Derivatives of the pixels with respect to the local levels, and the priors of these levels.

    The local levels are the coefficients of the light and the veil of each block of the sheet; see
    `local_rows`. The priors are given by their reciprocal variances and the gradient of their cost.
    """
    count, blocks = len(fit_state.inliers), scene.blocks
    if not scene.has_local_light or blocks is None:
        return scipy.sparse.csr_matrix((count, 0)), np.zeros(0), np.zeros(0)
    rows = local_rows(fit_state.rows_by_local(scene), blocks.basis).astype(float)
    column = LOCAL_TERMS * blocks.of_pixel + np.arange(LOCAL_TERMS)[:, None]
    row = np.tile(np.arange(count), LOCAL_TERMS)
    size = (count, LOCAL_TERMS * blocks.count)
    weight = np.tile(prior.local_weight, blocks.count)
    levels = np.asarray(fit_state.state.levels).T.ravel()
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
    """Displacements of all patches, with the shared unknowns eliminated.

    Parameters
    ----------
    by_px : (2, n) derivatives of the pixels' grey levels with respect to a displacement of the
        image in u and in v.
    patch : (n,) patch index of each pixel.
    count : number m of patches.
    residual, weight : (n,) residuals, and reciprocal variances of the pixels.
    shared : the shared unknowns.

    Returns
    -------
    (m, 2) displacements, px, and the (2m, 2m) matrix that whitens their errors. Its rows for
    directions that are not observable are 0.
    """
    rows, by_levels, weighted = shared.rows, shared.by_levels, by_px * weight

    def sum_by_patch(values: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "m k"]:
        """Sums over the pixels of each patch: `weighted` for u and for v, times `values`."""
        sums = [[np.bincount(patch, axis * row, count) for row in values] for axis in weighted]
        return np.array(sums).transpose(2, 0, 1).reshape(2 * count, len(values))

    across = np.concatenate(
        [sum_by_patch(rows.T), _sums_with_levels(weighted, patch, count, by_levels)], axis=1
    )
    by_weight, levels_by_weight = (rows * weight[:, None]).T, by_levels.multiply(weight[:, None]).T
    corner = levels_by_weight @ rows
    inner = np.block(
        [[by_weight @ rows, corner.T], [corner, (levels_by_weight @ by_levels).toarray()]]
    ) + np.diag(shared.prior)
    residual_gradient = np.concatenate([by_weight @ residual, levels_by_weight @ residual])
    shared_gradient = residual_gradient + shared.prior_gradient
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    eliminated = (across / scale) @ np.linalg.pinv(inner / np.outer(scale, scale), hermitian=True)
    patch_information = sum_by_patch(by_px).reshape(count, 2, 2)
    diagonal = np.zeros((count, 2, count, 2))
    diagonal[np.arange(count), :, np.arange(count)] = patch_information
    information = diagonal.reshape(2 * count, 2 * count) - eliminated @ (across / scale).T
    gradient = sum_by_patch(residual[None])[:, 0] - eliminated @ (shared_gradient / scale)
    basis = _observable_directions(patch_information)
    factor = np.linalg.cholesky(basis.T @ information @ basis)
    step = np.linalg.solve(factor.T, np.linalg.solve(factor, basis.T @ gradient))
    whitening = np.zeros((2 * count, 2 * count))
    whitening[: basis.shape[1]] = factor.T @ basis.T
    return -(basis @ step).reshape(count, 2), whitening


def _sums_with_levels(
    weighted: Float[np.ndarray, "2 n"],
    patch: Int[np.ndarray, "n"],
    count: int,
    by_levels: "scipy.sparse.csr_matrix",
) -> Float[np.ndarray, "m l"]:
    """Sums over each patch: `weighted` times the derivatives with respect to the local levels.

    weighted : (2, n) derivatives with respect to displacements in u and v, times pixel weights.
    """
    if not by_levels.shape[1]:  # pyright: ignore[reportOptionalSubscript]
        return np.zeros((2 * count, 0))
    pixel, column = np.tile(np.arange(len(patch)), 2), np.concatenate([2 * patch, 2 * patch + 1])
    by_patch = scipy.sparse.csr_matrix((weighted.ravel(), (column, pixel)), (2 * count, len(patch)))
    return scipy.sparse.csr_matrix(by_patch @ by_levels).toarray()


def _observable_directions(information: Float[np.ndarray, "c 2 2"]) -> Float[np.ndarray, "k q"]:
    """Directions along which the displacement of a patch is observable, as unit column vectors.

    A vector has entries for the displacements of all patches; only those of one patch are not zero.

    information : (c, 2, 2) information matrix of each patch's displacement.
    """
    count = len(information)
    values, vectors = np.linalg.eigh(information)
    basis = np.zeros((count, 2, count, 2))
    basis[np.arange(count), :, np.arange(count)] = vectors
    is_observable = values > _LEAST_SHARE * values[:, 1:]
    return basis.reshape(2 * count, 2 * count)[:, is_observable.ravel()]
