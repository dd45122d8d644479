"""Least squares of one circle to its chords."""

import numpy as np
from jaxtyping import Float

from trinoc.match.rims.circles import ON_ARC, Chords, Circles, off_circles
from trinoc.numerics import axes_across

PARAMETERS = 6
_STEPS = 2
# Residuals of so many standard deviations have half the weight.
_ROBUST = 3.0
# Derivatives are differences over this share of the radius.
_SHARE = 1e-5


def moved(circle: Circles, by: Float[np.ndarray, "k 6"]) -> Circles:
    """One circle moved in k ways: by its centre (mm), its normal toward its two axes across (rad),
    and its radius (mm)."""
    normal = circle.normal + by[:, 3:5] @ axes_across(circle.normal)[0]
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return Circles(circle.centre_mm + by[:, :3], normal, circle.radius_mm + by[:, 5])


def fitted(chords: Chords, circle: Circles) -> tuple[Circles, Float[np.ndarray, "6 6"], float]:
    """(the likeliest circle near this one, covariance of what `moved` moves, chi-square).

    The covariance is that of the errors found where they are larger than stated.
    """
    for _ in range(_STEPS):
        residual, jacobian, scale = _linearised(chords, circle)
        weight = 1 / (1 + (residual / _ROBUST) ** 2)
        step = -np.linalg.pinv(np.sqrt(weight)[:, None] * jacobian) @ (np.sqrt(weight) * residual)
        # A step further than a third of the radius has left what is nearly linear.
        step = step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
        circle = moved(circle, (step * scale)[None])
    residual, jacobian, scale = _linearised(chords, circle)
    weight = 1 / (1 + (residual / _ROBUST) ** 2)
    square = float((weight * residual**2).sum())
    degrees = max(len(residual) - PARAMETERS, 1)
    covariance = np.linalg.pinv(jacobian.T @ (weight[:, None] * jacobian), hermitian=True)
    covariance = covariance * max(square / degrees, 1.0) * scale[:, None] * scale
    return circle, covariance, square


def _linearised(
    chords: Chords, circle: Circles
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m 6"], Float[np.ndarray, "6"]]:
    """(residuals in standard deviations, their derivatives by scaled parameters, the scales)."""
    radius = float(circle.radius_mm[0])
    scale = np.array([radius, radius, radius, 1.0, 1.0, radius])
    steps = _SHARE * np.diag(scale)
    every = moved(circle, np.concatenate([np.zeros((1, PARAMETERS)), steps, -steps]))
    off = off_circles(chords, every).px[..., ON_ARC] / chords.sigma_px[:, None]
    off = np.clip(off, -1e3, 1e3).reshape(len(off), -1)
    return off[0], (off[1 : PARAMETERS + 1] - off[PARAMETERS + 1 :]).T / (2 * _SHARE), scale
