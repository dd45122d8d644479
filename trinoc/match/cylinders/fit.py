"""Least squares of cylinders to the outlines that views show of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.cylinders.outlines import Outlines
from trinoc.match.cylinders.tangency import abreast_mm, passing
from trinoc.match.tuning import CylinderTuning
from trinoc.numerics import axes_across

# Parameters of an axis and a radius, and of an axis alone.
ROUND, STRAIGHT = 5, 4
STEPS = 4
# An eigenvalue of the information, all columns scaled alike, below this share of the largest is
# rounding: the outlines leave that direction free.
SMALLEST_SHARE = 1e-9


class Members(NamedTuple):
    """The outlines of each cylinder. row : in the table, -1 beyond its last. side : of the axis,
    1 or -1, see `tangency`."""

    row: Int[np.ndarray, "h k"]
    side: Float[np.ndarray, "h k"]

    @property
    def held(self) -> Bool[np.ndarray, "h k"]:
        """Where there is one."""
        return self.row >= 0


class Fits(NamedTuple):
    """Cylinders that outlines leave.

    point_mm, direction : of the axis; the point is abreast of the middle of the outlines.
    radius_mm : of each. information : of offset (mm) and tilt (rad) of the axis, each in
    its two axes across, and of the radius (mm). log_likelihood : of the outlines' displacements
    across, per pixel of each end. square : chi-square. degrees : of freedom. rank : of the
    information; below 5 the outlines leave the cylinder open. A line is a cylinder without a
    radius, which has four parameters.
    """

    point_mm: Float[np.ndarray, "h 3"]
    direction: Float[np.ndarray, "h 3"]
    radius_mm: Float[np.ndarray, "h"]
    information: Float[np.ndarray, "h p p"]
    log_likelihood: Float[np.ndarray, "h"]
    square: Float[np.ndarray, "h"]
    degrees: Int[np.ndarray, "h"]
    rank: Int[np.ndarray, "h"]

    def take(self, rows: np.ndarray) -> "Fits":
        """Some of them."""
        return Fits(*(column[rows] for column in self))


def fitted(
    table: Outlines,
    members: Members,
    point_mm: Float[np.ndarray, "h 3"],
    direction: Float[np.ndarray, "h 3"],
    radius_mm: Float[np.ndarray, "h"],
    tuning: CylinderTuning,
    parameters: int = ROUND,
) -> Fits:
    """The likeliest cylinders, by Gauss-Newton from given ones; STRAIGHT holds their radii."""
    held, own = members.held, table.take(np.maximum(members.row, 0))
    for _ in range(STEPS):
        along = abreast_mm(own.rays, point_mm[:, None], direction[:, None])
        middle = (along.mean(axis=2) * held).sum(axis=1) / held.sum(axis=1)
        reach = (np.ptp(along, axis=2) * held).max(axis=1, initial=0.0)
        point_mm = point_mm + middle[:, None] * direction
        weighted = _weighted(own, members, point_mm, direction, radius_mm, tuning)
        information = weighted.information[:, :parameters, :parameters]
        gradient = weighted.gradient[:, :parameters]
        # An axis through a centre of projection is seen as a point: it has no outlines.
        seen = np.isfinite(information).all(axis=(1, 2)) & np.isfinite(gradient).all(axis=1)
        information = np.where(seen[:, None, None], information, 0.0)
        gradient = np.where(seen[:, None], gradient, 0.0)
        scale = 1 / np.sqrt(np.maximum(np.einsum("hii->hi", information), 1e-300))
        scaled = information * scale[:, :, None] * scale[:, None]
        rank = (np.linalg.eigvalsh(scaled) > SMALLEST_SHARE).sum(axis=1)
        step = scale * np.einsum(
            "hij,hj->hi", np.linalg.pinv(scaled, rcond=SMALLEST_SHARE, hermitian=True),
            gradient * scale,
        )  # fmt: skip
        # A step further than the outlines are long has left what is nearly linear.
        step = step / np.maximum(np.abs(step[:, :2]).max(axis=1) / reach, 1.0)[:, None]
        across = axes_across(direction)
        point_mm = point_mm + np.einsum("hi,hij->hj", step[:, :2], across)
        direction = direction + np.einsum("hi,hij->hj", step[:, 2:4], across)
        direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        if parameters == ROUND:
            radius_mm = np.maximum(radius_mm + step[:, 4], 0.1 * radius_mm)
    weighted = _weighted(own, members, point_mm, direction, radius_mm, tuning)
    return Fits(
        point_mm,
        direction,
        radius_mm,
        weighted.information[:, :parameters, :parameters],
        weighted.log_likelihood,
        weighted.square,
        2 * held.sum(axis=1) - parameters,
        rank,
    )


class _Weighted(NamedTuple):
    information: Float[np.ndarray, "h 5 5"]
    gradient: Float[np.ndarray, "h 5"]
    square: Float[np.ndarray, "h"]
    log_likelihood: Float[np.ndarray, "h"]


def _weighted(
    own: Outlines,
    members: Members,
    point_mm: Float[np.ndarray, "h 3"],
    direction: Float[np.ndarray, "h 3"],
    radius_mm: Float[np.ndarray, "h"],
    tuning: CylinderTuning,
) -> _Weighted:
    """Normal equations of the step toward the likeliest cylinder."""
    rays = passing(own.rays, point_mm[:, None], direction[:, None])
    side = members.side[:, :, None]
    residual = (side * radius_mm[:, None, None] - rays.distance_mm) / rays.per_px
    jacobian = np.concatenate(
        [rays.by_axis, -np.broadcast_to(side[..., None], (*residual.shape, 1))], axis=-1
    )
    jacobian = jacobian / rays.per_px[..., None]
    inverse = np.linalg.inv(own.across_px2)
    square = np.einsum("hke,hkef,hkf->hk", residual, inverse, residual)
    # Errors of both ends together are larger than stated by one of these factors.
    scale2 = np.square(tuning.error_scales)
    density = np.array(tuning.error_shares) / scale2 * np.exp(-0.5 * square[..., None] / scale2)
    total = np.maximum(density.sum(axis=-1), 1e-300)
    weight = (density / scale2).sum(axis=-1) / total
    inverse = inverse * (np.maximum(weight, scale2[-1] ** -1) * members.held)[:, :, None, None]
    weighted = np.einsum("hkef,hkfp->hkep", inverse, jacobian)
    log_det = np.log(np.linalg.det(own.across_px2))
    log_likelihood = np.log(total) - 0.5 * log_det - np.log(2 * np.pi)
    return _Weighted(
        np.einsum("hkep,hkeq->hpq", jacobian, weighted),
        np.einsum("hkep,hke->hp", weighted, residual),
        (square * members.held).sum(axis=1),
        (log_likelihood * members.held).sum(axis=1),
    )
