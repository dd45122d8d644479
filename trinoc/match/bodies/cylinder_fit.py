"""Least squares of cylinders to the outlines that views show of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.bodies.outlines import Outlines, abreast_mm, ray_axis_distances
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.numerics.robust_loss import ScaleMixture
from trinoc.numerics.small_least_squares import Residuals, gauss_newton, whitening
from trinoc.numerics.tables import take_rows
from trinoc.numerics.vectors import complete_axes

# numerical: parameters of an axis and a radius, and of an axis alone.
ROUND, STRAIGHT = 5, 4
# numerical: Gauss-Newton steps, which converge.
STEPS = 4
# numerical: at least so much of a radius is left by a step.
_LEAST_SHARE = 0.1


class Members(NamedTuple):
    """The outlines of each cylinder. row : in the table, -1 beyond its last. side : of the axis,
    1 or -1, see `ray_axis_distances`."""

    row: Int[np.ndarray, "h k"]
    side: Float[np.ndarray, "h k"]

    @property
    def held(self) -> Bool[np.ndarray, "h k"]:
        """Where there is one."""
        return self.row >= 0

    def rows_of(self, table: Outlines) -> Outlines:
        """Those outlines, (h, k); any where there is none."""
        return take_rows(table, np.maximum(self.row, 0))


class Fits(NamedTuple):
    """Cylinders that outlines leave.

    point_mm, direction : of the axis; the point is abreast of the middle of the outlines.
    radius_mm : of each. information : of offset (mm) and tilt (rad) of the axis, each in
    its two axes across, and of the radius (mm). covariance : of these; not a number where the
    outlines leave the cylinder open. log_likelihood : of the outlines' displacements across, per
    pixel of each end. square : chi-square. degrees : of freedom. A line is a cylinder without a
    radius, which has four parameters.
    """

    point_mm: Float[np.ndarray, "h 3"]
    direction: Float[np.ndarray, "h 3"]
    radius_mm: Float[np.ndarray, "h"]
    information: Float[np.ndarray, "h p p"]
    covariance: Float[np.ndarray, "h p p"]
    log_likelihood: Float[np.ndarray, "h"]
    square: Float[np.ndarray, "h"]
    degrees: Int[np.ndarray, "h"]


class _Axes(NamedTuple):
    point_mm: Float[np.ndarray, "h 3"]
    direction: Float[np.ndarray, "h 3"]
    radius_mm: Float[np.ndarray, "h"]


def fit_cylinders(
    table: Outlines,
    members: Members,
    point_mm: Float[np.ndarray, "h 3"],
    direction: Float[np.ndarray, "h 3"],
    radius_mm: Float[np.ndarray, "h"],
    tuning: MatchTuning,
    parameters: int = ROUND,
) -> Fits:
    """The likeliest cylinders, by Gauss-Newton from given ones; STRAIGHT holds their radii.

    Errors of both ends of a segment together are larger than stated by one of a few factors.
    """
    held, own = members.held, members.rows_of(table)
    side, by = members.side[:, :, None], whitening(own.across_px2)
    loss = ScaleMixture(tuning.collinear.error_shares, tuning.collinear.error_scales, 2)

    def residuals(at: _Axes) -> Residuals:
        rays = ray_axis_distances(own.rays, at.point_mm[:, None], at.direction[:, None])
        residual = (rays.distance_mm - side * at.radius_mm[:, None, None]) / rays.per_px
        turned = -np.broadcast_to(side[..., None], (*residual.shape, 1))
        jacobian = np.concatenate([rays.by_axis, turned], axis=-1)[..., :parameters]
        jacobian = by @ (jacobian / rays.per_px[..., None])
        return Residuals((by @ residual[..., None])[..., 0], jacobian, held)

    def abreast(at: _Axes) -> tuple[_Axes, Float[np.ndarray, "h k 2"]]:
        """(with the point abreast of the middle of the outlines, where along it rays pass)."""
        along = abreast_mm(own.rays, at.point_mm[:, None], at.direction[:, None])
        middle = (along.mean(axis=2) * held).sum(axis=1) / held.sum(axis=1)
        return at._replace(point_mm=at.point_mm + middle[:, None] * at.direction), along

    def retract(at: _Axes, step: Float[np.ndarray, "h p"]) -> _Axes:
        across = complete_axes(at.direction)
        direction = at.direction + np.einsum("hi,hij->hj", step[:, 2:4], across)
        moved = _Axes(
            at.point_mm + np.einsum("hi,hij->hj", step[:, :2], across),
            direction / np.linalg.norm(direction, axis=1, keepdims=True),
            np.maximum(at.radius_mm + step[:, 4:].sum(axis=1), _LEAST_SHARE * at.radius_mm),
        )
        return abreast(moved)[0]

    start, along = abreast(_Axes(point_mm, direction, radius_mm))
    # A step across further than the outlines are long has left what is nearly linear.
    largest = np.full((len(held), parameters), np.inf)
    reach = (np.ptp(along, axis=2) * held).max(axis=1, initial=np.finfo(float).tiny)
    largest[:, :2] = reach[:, None]
    best, equations = gauss_newton(
        residuals, retract, start, steps=STEPS, loss=loss, largest_step=largest
    )
    log_size = np.log(np.einsum("hkee->hke", by)).sum(axis=2)
    log_likelihood = np.asarray(loss.log_density(equations.squared)) + log_size
    return Fits(
        *best,
        equations.information,
        equations.covariance(),
        (log_likelihood * held).sum(axis=1),
        (equations.squared * held).sum(axis=1),
        2 * held.sum(axis=1) - parameters,
    )
