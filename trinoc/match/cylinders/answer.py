"""Which cylinders are put out, since an outline belongs to one of them, and where these end."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit

from trinoc.match.cylinders.fit import Fits, Members
from trinoc.match.cylinders.outlines import Outlines, abreast_mm
from trinoc.match.cylinders.support import outline_of
from trinoc.match.tuning import CylinderTuning
from trinoc.numerics import axes_across, chi_square_limit


class Chosen(NamedTuple):
    """row : of the cylinders put out, the likeliest first. rival : posterior of the best other
    cylinder that shares an outline with each."""

    row: Int[np.ndarray, "c"]
    rival: Float[np.ndarray, "c"]


def choose_cylinders(
    fits: Fits, members: Members, log_odds: Float[np.ndarray, "h"], tuning: CylinderTuning
) -> Chosen:
    """The likeliest first, then those that share no outline with any of them."""
    posterior = expit(log_odds)
    left = posterior >= tuning.least_posterior
    found, rivals = [], []
    for row in np.argsort(-log_odds, kind="stable").tolist():
        if not left[row]:
            continue
        own = members.row[row][members.held[row]]
        sharing = np.isin(members.row, own).any(axis=1)
        left &= ~sharing
        other = np.flatnonzero(sharing)
        other = other[differs(fits, row, other, tuning.significance)]
        found.append(row)
        rivals.append(posterior[other].max(initial=0.0))
    return Chosen(np.array(found, dtype=np.int64), np.array(rivals))


def differs(
    fits: Fits, row: int, others: Int[np.ndarray, "o"], significance: float
) -> Bool[np.ndarray, "o"]:
    """Whether others are another cylinder, by the errors of both."""
    direction, across = fits.direction[row], axes_across(fits.direction[row])
    along = fits.direction[others] @ direction
    way = fits.direction[others] * np.where(along < 0, -1.0, 1.0)[:, None]
    apart = fits.point_mm[others] - fits.point_mm[row]
    reach = (apart @ direction) / np.maximum(np.abs(along), 1e-6)
    offset = (apart - reach[:, None] * way) @ across.T
    change = np.column_stack([offset, way @ across.T, fits.radius_mm[others] - fits.radius_mm[row]])
    # The others' own errors are taken as large as this one's.
    square = 0.5 * np.einsum("op,pq,oq->o", change, fits.information[row], change)
    return square > chi_square_limit(significance, change.shape[1])


def place_ends(
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
    covariance = jacobian @ fits.covariance @ jacobian.mT
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
