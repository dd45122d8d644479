"""Which cylinders are put out: an outline belongs to one of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit

from trinoc.match.cylinders.fit import Fits, Members
from trinoc.match.tuning import CylinderTuning
from trinoc.numerics import axes_across, chi_square_limit


class Chosen(NamedTuple):
    """row : of the cylinders put out, the likeliest first. rival : posterior of the best other
    cylinder that shares an outline with each."""

    row: Int[np.ndarray, "c"]
    rival: Float[np.ndarray, "c"]


def chosen(
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
