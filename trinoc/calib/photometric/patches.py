"""Where the picture shows each circle and each piece of the crossed lines.

At the end of the fit a patch of the sheet may still be displaced in the picture, because paper
bends or the lens is another than was said. The grey levels tell by how much, all patches sharing
one appearance: normal equations in the displacements, from which the appearance is eliminated.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.model import SheetPoints
from trinoc.calib.photometric.gauss_newton import Group, Sums, sheet_from_normalised
from trinoc.calib.photometric.pixel_selection import SelectedPixels
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens
from trinoc.numerics import ArrayLike

# Pieces along each half of the two lines.
_PIECES = 8
# A direction that a patch shows with less than this share of the information of its best one, as
# a line along itself, is not known.
_LEAST_SHARE = 1e-3


class _Rows(NamedTuple):
    """Pixels as rows of the linearised model: (n, 2) places in mm, (n, 2 + K + 1) derivatives by a
    shift of the picture in px and by the appearance, and the residual, whitened; (n,) patches."""

    place_mm: Float[np.ndarray, "n 2"]
    rows: Float[np.ndarray, "n k"]
    patch: Int[np.ndarray, "n"]


def patch_points(
    lens: AbstractLens,
    pattern: Pattern,
    groups: tuple[Group, Group],
    chosen: tuple[SelectedPixels, SelectedPixels],
    sums: Sums,
    noise: float,
) -> SheetPoints:
    """The patches that a picture shows, for independent noise of standard deviation `noise`.

    groups, chosen : pixels near circles only, and near a line. sums : at the end of the fit.
    """
    # The pixels were looked at through what single precision leaves of the homography.
    matrix = np.asarray(_homography(sums.pose)).astype(np.float32).astype(np.float64)
    parts = [
        _rows(group, pixels, np.asarray(columns), np.asarray(residuals), matrix)
        for group, pixels, columns, residuals in zip(
            groups, chosen, sums.columns, sums.residuals, strict=True
        )
    ]
    near_lines = parts[1]
    pieces = len(pattern) + _piece(near_lines.place_mm, pattern)
    everything = _Rows(
        *(
            np.concatenate(pair)
            for pair in zip(parts[0], near_lines._replace(patch=pieces), strict=True)
        )
    )
    places, blocks = _sums_of_patches(everything)
    shift, whitening = _displacements(blocks / noise**2)
    shown = np.asarray(_images(lens, np.linalg.inv(matrix), places))
    return SheetPoints(places, shown + shift, whitening)


_homography = jax.jit(sheet_from_normalised)


@jax.jit
def _images(
    lens: AbstractLens,
    normalised_from_sheet: Float[ArrayLike, "3 3"],
    places_mm: Float[ArrayLike, "m 2"],
) -> Float[ArrayLike, "m 2"]:
    def image(place: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        return lens.project_ray(normalised_from_sheet @ jnp.append(place, 1.0))

    return jax.vmap(image)(places_mm)


def _rows(
    group: Group,
    chosen: SelectedPixels,
    columns: Float[np.ndarray, "k c"],
    residuals: Float[np.ndarray, "c"],
    matrix: Float[np.ndarray, "3 3"],
) -> _Rows:
    count = len(chosen.row)
    weight = np.asarray(group.pixels.weight[:count], dtype=np.float64)
    kept = np.flatnonzero(weight)
    ray = group.pixels.ray
    x, y = np.asarray(ray.normalised, dtype=np.float64)[kept].T
    on_sheet = matrix @ np.stack([x, y, np.ones_like(x)])
    # A picture that is shifted by d shows at x what it showed at x - d.
    by_normalised = -matrix[:, :2].T @ columns[:3, kept]
    by_px = np.einsum("jn,njk->nk", by_normalised, np.asarray(ray.by_pixel)[kept])
    rows = np.concatenate([by_px, columns[3:, kept].T, residuals[kept, None]], axis=1)
    return _Rows(
        (on_sheet[:2] / on_sheet[2]).T, rows * np.sqrt(weight[kept, None]), chosen.circle[kept]
    )


def _piece(place_mm: Float[np.ndarray, "n 2"], pattern: Pattern) -> Int[np.ndarray, "n"]:
    """The piece of a line that each place is on: of the line along X, then of the one along Y."""
    x, y = place_mm.T
    along_y = np.abs(y) > np.abs(x)
    reach = np.where(along_y, pattern.line_half_length_mm[1], pattern.line_half_length_mm[0])
    along = np.where(along_y, y, x) / reach
    last = 2 * _PIECES - 1
    return np.clip(np.floor((along + 1) * _PIECES), 0, last).astype(int) + along_y * (last + 1)


def _sums_of_patches(
    pixels: _Rows,
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m k k"]]:
    """Centroid of each patch, by what its pixels know, and its sums of products."""
    order = np.argsort(pixels.patch, kind="stable")
    rows, place = pixels.rows[order], pixels.place_mm[order]
    starts = np.flatnonzero(np.diff(pixels.patch[order], prepend=-2))
    places, blocks = [], []
    for start, end in zip(starts, [*starts[1:], len(order)], strict=True):
        part = rows[start:end].astype(np.float64)
        share = np.sum(part[:, :2] ** 2, axis=1)
        if share.sum() > 0:
            places.append(share @ place[start:end] / share.sum())
            blocks.append(part.T @ part)
    return np.stack(places), np.stack(blocks)


def _displacements(
    blocks: Float[np.ndarray, "m k k"],
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "q q"]]:
    """Shift of each patch in px, and R of all their errors, the appearance being eliminated."""
    count = len(blocks)
    common = blocks[:, 2:, 2:].sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(common)[:-1], 1e-300))
    look, look_slope = common[:-1, :-1] / np.outer(scale, scale), common[:-1, -1] / scale
    across = (blocks[:, :2, 2:-1] / scale).reshape(2 * count, -1)
    eliminated = across @ np.linalg.pinv(look, hermitian=True)
    information = -eliminated @ across.T
    slope = blocks[:, :2, -1].reshape(-1) - eliminated @ look_slope
    basis = []
    for k, block in enumerate(blocks[:, :2, :2]):
        rows = slice(2 * k, 2 * k + 2)
        information[rows, rows] += block
        values, vectors = np.linalg.eigh(block)
        for value, vector in zip(values, vectors.T, strict=True):
            if value > _LEAST_SHARE * values[-1]:
                basis.append(np.zeros(2 * count))
                basis[-1][rows] = vector
    known = np.stack(basis, axis=1)
    factor = np.linalg.cholesky(known.T @ information @ known)
    step = np.linalg.solve(factor.T, np.linalg.solve(factor, known.T @ slope))
    whitening = np.zeros((2 * count, 2 * count))
    whitening[: known.shape[1]] = factor.T @ known.T
    return -(known @ step).reshape(count, 2), whitening
