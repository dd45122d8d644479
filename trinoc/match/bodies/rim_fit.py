"""Least squares of one circle to its chords."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.match.bodies.circles import ON_ARC, Chords, Circles, off_circles
from trinoc.numerics import Cauchy, Residuals, axes_across, gauss_newton, misfit_factor

_STEPS = 2
# Residuals of so many standard deviations have half the weight.
_ROBUST = Cauchy(3.0)
# A step further than this share of the radius, or of a radian, has left what is nearly linear.
_LARGEST_STEP = 0.3
# Derivatives are differences over this share of the radius.
_SHARE = 1e-5
# Of standard deviations: further off is as far off.
_FAR = 1e3


class CircleFit(NamedTuple):
    """The likeliest circle near one. covariance : of what `move_circle` moves, that of the errors
    found where they are larger than stated; not a number where the chords leave it open."""

    circle: Circles
    covariance: Float[np.ndarray, "6 6"]


def move_circle(circle: Circles, by: Float[np.ndarray, "k 6"]) -> Circles:
    """One circle moved in k ways: by its centre (mm), its normal toward its two axes across (rad),
    and its radius (mm)."""
    normal = circle.normal + by[:, 3:5] @ axes_across(circle.normal)[0]
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return Circles(circle.centre_mm + by[:, :3], normal, circle.radius_mm + by[:, 5])


def fit_circle(chords: Chords, circle: Circles) -> CircleFit:
    """The likeliest circle near this one, by the two places of each chord that lie on its arc."""
    circle, equations = gauss_newton(
        lambda at: _residuals(chords, at),
        lambda at, step: move_circle(at, step * _scale(at)),
        circle,
        steps=_STEPS,
        loss=_ROBUST,
        largest_step=_LARGEST_STEP,
    )
    scale = _scale(circle)
    places, parameters = equations.squared.shape[1], len(scale)
    factor = misfit_factor(equations.chi_square, places - parameters)[0]
    return CircleFit(circle, factor * equations.covariance()[0] * scale[:, None] * scale)


def _scale(circle: Circles) -> Float[np.ndarray, "6"]:
    """What of each parameter moves the circle by about its radius."""
    radius = float(circle.radius_mm[0])
    return np.array([radius, radius, radius, 1.0, 1.0, radius])


def _residuals(chords: Chords, circle: Circles) -> Residuals:
    """How far each place is off the circle's image, by parameters in units of their scale."""
    steps = _SHARE * np.diag(_scale(circle))
    every = move_circle(circle, np.concatenate([np.zeros((1, 6)), steps, -steps]))
    off = off_circles(chords, every).px[..., ON_ARC] / chords.sigma_px[:, None]
    here, forth, back = np.split(np.clip(off, -_FAR, _FAR).reshape(len(off), -1), [1, 7])
    slope = (forth - back).T / (2 * _SHARE)
    return Residuals(here[..., None], slope[None, :, None])
