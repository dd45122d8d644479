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

from trinoc.calib.model import SheetPoints
from trinoc.calib.photometric.gauss_newton import sheet_from_camera
from trinoc.calib.photometric.local_light import WIDTH, Blocks
from trinoc.calib.photometric.sheet_point import Ray
from trinoc.calib.targets import Pattern, SquareSheet
from trinoc.geometry import AbstractLens
from trinoc.numerics import ArrayLike

# Pieces along each half of the two lines.
_PIECES = 8
# A direction that a patch shows with less than this share of the information of its best one, as
# a line along itself, is not known.
_LEAST_SHARE = 1e-3


_NOTHING = SheetPoints(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0)))


class LocalLight(NamedTuple):
    """Levels of light that each block of the sheet has for itself.

    Fields
    ------
    blocks : of the pixels.
    rows : (6, n) derivatives of each pixel by the levels of its block.
    levels : (6, b) where the fit ended.
    """

    blocks: Blocks
    rows: Float[np.ndarray, "6 n"]
    levels: Float[np.ndarray, "6 b"]


class PixelRows(NamedTuple):
    """Pixels as rows of the linearised model at the end of a fit.

    Fields
    ------
    circle : (n,) of pixels near circles only, -1 for those near a line.
    ray : of each pixel.
    by_homography : (3, n) derivatives by the third column of the homography to the sheet, which a
        shift of the picture changes.
    by_look : (q, n) by the appearance.
    residual, weight : (n,) predicted minus observed, and what each counts.
    prior, pull : (q,) information of the appearance's prior and its gradient.
    local : light of blocks, or None.
    """

    circle: Int[np.ndarray, "n"]
    ray: Ray
    by_homography: Float[np.ndarray, "3 n"]
    by_look: Float[np.ndarray, "q n"]
    residual: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]
    prior: Float[np.ndarray, "q"]
    pull: Float[np.ndarray, "q"]
    local: LocalLight | None = None


def patch_points(
    lens: AbstractLens,
    pattern: Pattern | SquareSheet,
    homography: Float[np.ndarray, "3 3"],
    pixels: PixelRows,
) -> SheetPoints:
    """The patches that a picture shows; none where the fit has left all that is finite.

    homography : from directions in the camera to the sheet, at which the rows are.
    """
    direction = np.asarray(pixels.ray.direction, dtype=np.float64).T
    on_sheet = homography @ direction
    place = (on_sheet[:2] / on_sheet[2]).T
    # A picture that is shifted by d shows at x what it showed at x - d. The third column of the
    # homography acts by the third coordinate of the ray.
    by_direction = -homography.T @ (pixels.by_homography / direction[2])
    by_px = np.einsum("jn,njk->kn", by_direction, np.asarray(pixels.ray.by_pixel))
    numbers = place, by_px, pixels.weight, pixels.by_look
    if not all(np.isfinite(part).all() for part in numbers):
        return _NOTHING
    label = pixels.circle
    if isinstance(pattern, Pattern):
        piece = len(pattern) + _piece_of_line(place, pattern)
        label = np.where(label >= 0, label, piece)
    known = (by_px**2).sum(axis=0) * pixels.weight
    label, known = _numbered(label, known)
    total = np.bincount(label, known)
    middle = np.stack([np.bincount(label, known * axis) / total for axis in place.T], axis=1)
    try:
        shift, whitening = _displacements(pixels, by_px, label, len(total))
    except np.linalg.LinAlgError:
        return _NOTHING
    shown = np.asarray(_images(lens, np.linalg.inv(homography), middle))
    return SheetPoints(middle, shown + shift, whitening)


homography_of_pose = jax.jit(sheet_from_camera)


@jax.jit
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
    last = 2 * _PIECES - 1
    return np.clip(np.floor((along + 1) * _PIECES), 0, last).astype(int) + along_y * (last + 1)


def _numbered(
    label: Int[np.ndarray, "n"], known: Float[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Patches of which something is known numbered from 0; pixels of others count to the first."""
    useful = np.flatnonzero(np.bincount(label, known) > 0)
    number = np.zeros(label.max() + 1, dtype=int)
    number[useful] = np.arange(len(useful))
    return number[label], np.where(np.isin(label, useful), known, 0.0)


def _displacements(
    pixels: PixelRows,
    by_px: Float[np.ndarray, "2 n"],
    patch: Int[np.ndarray, "n"],
    count: int,
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "q q"]]:
    """Shift of each patch in px, and R of all their errors, the appearance being eliminated."""
    number = np.arange(len(patch))
    weight, residual = pixels.weight, pixels.residual.astype(np.float64)
    shifts = scipy.sparse.csr_matrix(
        (by_px.ravel(), (np.tile(number, 2), np.concatenate([2 * patch, 2 * patch + 1]))),
        (len(patch), 2 * count),
    )
    weighted = shifts.multiply(weight[:, None]).tocsr()
    look = pixels.by_look.astype(np.float64).T
    across, inner = weighted.T @ look, (look.T * weight) @ look + np.diag(pixels.prior)
    pull = look.T @ (weight * residual) + pixels.pull
    if pixels.local is not None:
        blocks, rows, levels = pixels.local
        place = 6 * blocks.of_pixel + np.arange(6)[:, None]
        local = scipy.sparse.csr_matrix(
            (rows.ravel(), (np.tile(number, 6), place.ravel())), (len(patch), 6 * blocks.count)
        )
        own = (local.multiply(weight[:, None]).T @ local).toarray()
        own += np.diag(np.tile(WIDTH**-2, blocks.count))
        between = local.multiply(weight[:, None]).T @ look
        inner = np.block([[inner, between.T], [between, own]])
        across = np.concatenate([across, (weighted.T @ local).toarray()], axis=1)
        levels_pull = local.T @ (weight * residual) + (levels.T / WIDTH**2).ravel()
        pull = np.concatenate([pull, levels_pull])
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    eliminated = (across / scale) @ np.linalg.pinv(inner / np.outer(scale, scale), hermitian=True)
    alone = (weighted.T @ shifts).toarray()
    information = alone - eliminated @ (across / scale).T
    slope = weighted.T @ residual - eliminated @ (pull / scale)
    known = _known_directions(alone, count)
    factor = np.linalg.cholesky(known.T @ information @ known)
    step = np.linalg.solve(factor.T, np.linalg.solve(factor, known.T @ slope))
    whitening = np.zeros((2 * count, 2 * count))
    whitening[: known.shape[1]] = factor.T @ known.T
    return -(known @ step).reshape(count, 2), whitening


def _known_directions(alone: Float[np.ndarray, "k k"], count: int) -> Float[np.ndarray, "k q"]:
    """Unit vectors along which patches are known by themselves."""
    basis = []
    for k in range(count):
        rows = slice(2 * k, 2 * k + 2)
        values, vectors = np.linalg.eigh(alone[rows, rows])
        for value, vector in zip(values, vectors.T, strict=True):
            if value > _LEAST_SHARE * values[-1]:
                basis.append(np.zeros(2 * count))
                basis[-1][rows] = vector
    return np.stack(basis, axis=1)
