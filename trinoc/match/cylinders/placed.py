"""Where cylinders end, and the covariance of their ends and radii."""

import numpy as np
from jaxtyping import Float

from trinoc.match.cylinders.fit import Fits, Members
from trinoc.match.cylinders.outlines import Outlines
from trinoc.match.cylinders.support import outline_of
from trinoc.match.cylinders.tangency import abreast_mm
from trinoc.numerics import axes_across


def placed(
    table: Outlines, fits: Fits, members: Members, free_end_px: float
) -> tuple[Float[np.ndarray, "c 2 3"], Float[np.ndarray, "c 7 7"]]:
    """(ends of each axis as far as two outlines reach, covariance of both and the radius)."""
    own = table.take(np.maximum(members.row, 0))
    along = np.sort(abreast_mm(own.rays, fits.point_mm[:, None], fits.direction[:, None]), axis=2)
    mm_per_px = ((along[..., 1] - along[..., 0]) / own.length_px * members.held).sum(axis=1)
    mm_per_px = mm_per_px / np.maximum(members.held.sum(axis=1), 1)
    reach = _reach_of_two(along, outline_of(table, members))
    axis = fits.point_mm[:, None] + reach[:, :, None] * fits.direction[:, None]
    across = axes_across(fits.direction)
    count = len(reach)
    jacobian = np.zeros((count, 7, 5))
    for end in (0, 1):
        rows = slice(3 * end, 3 * end + 3)
        jacobian[:, rows, :2] = across.mT
        jacobian[:, rows, 2:4] = reach[:, end, None, None] * across.mT
    jacobian[:, 6, 4] = 1.0
    covariance = jacobian @ np.linalg.inv(fits.information) @ jacobian.mT
    stops = np.einsum("ci,cj->cij", fits.direction, fits.direction)
    for end in (0, 1):
        rows = slice(3 * end, 3 * end + 3)
        covariance[:, rows, rows] += (free_end_px * mm_per_px)[:, None, None] ** 2 * stops
    return axis, covariance


def _reach_of_two(
    along_mm: Float[np.ndarray, "c k 2"], outline: np.ndarray
) -> Float[np.ndarray, "c 2"]:
    """From where to where at least two outlines, each with all its pieces, reach."""
    count, number = len(along_mm), int(outline.max(initial=1)) + 1
    low, high = np.full((count, number), np.inf), np.full((count, number), -np.inf)
    owner, column = np.nonzero(outline >= 0)
    of = outline[owner, column]
    np.minimum.at(low, (owner, of), along_mm[owner, column, 0])
    np.maximum.at(high, (owner, of), along_mm[owner, column, 1])
    return np.stack([np.sort(low, axis=1)[:, 1], np.sort(high, axis=1)[:, -2]], axis=1)
