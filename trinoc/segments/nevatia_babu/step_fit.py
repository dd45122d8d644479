"""Blurred steps fitted to mean profiles, by Gauss and Newton, with prior knowledge."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

_ROUNDS = 10
# At most so much at a time: place, logarithm of the height, floor, logarithm of the width.
_LARGEST = np.array([0.4, 0.3, np.inf, 0.2])


class StepFit(NamedTuple):
    """Of each line: place, logarithm of the width, variance of the place, cost, and its part that
    is the data's."""

    place_px: Float[np.ndarray, "s"]
    log_width: Float[np.ndarray, "s"]
    variance_px2: Float[np.ndarray, "s"]
    cost: Float[np.ndarray, "s"]
    misfit: Float[np.ndarray, "s"]


def step_fit(
    across: Float[np.ndarray, "s b"],
    level: Float[np.ndarray, "s b"],
    information: Float[np.ndarray, "s b"],
    visible: Float[np.ndarray, "s"],
    start: Float[np.ndarray, "s 4"],
    prior: Float[np.ndarray, "s 4"],
    weight: Float[np.ndarray, "4"],
    least_above: float,
) -> StepFit:
    """Gauss and Newton for all lines together, with what is known beforehand.

    Unknowns: place, logarithm of the height over the visible one, floor, logarithm of the width.
    """
    state = start
    for _ in range(_ROUNDS):
        residual, jacobian = _residuals(state, across, level, visible)
        weighted = jacobian * information[..., None]
        transposed = weighted.transpose(0, 2, 1)
        normal = transposed @ jacobian + np.diag(weight + 1e-6)
        gradient = (transposed @ residual[..., None])[..., 0] + weight * (prior - state)
        change = np.linalg.solve(normal, gradient[..., None])[..., 0]
        state = state + np.clip(change, -_LARGEST, _LARGEST)
        state[:, 1] = np.maximum(state[:, 1], least_above)
    residual, _ = _residuals(state, across, level, visible)
    misfit = (information * residual**2).sum(axis=1)
    cost = misfit + (weight * np.square(state - prior)).sum(axis=1)
    return StepFit(state[:, 0], state[:, 3], np.linalg.inv(normal)[:, 0, 0], cost, misfit)


def _residuals(
    state: Float[np.ndarray, "s 4"],
    across: Float[np.ndarray, "s b"],
    level: Float[np.ndarray, "s b"],
    visible: Float[np.ndarray, "s"],
) -> tuple[np.ndarray, np.ndarray]:
    """(residual, jacobian of the model): a blurred step beside the levels."""
    place, above, base, log_width = (column[:, None] for column in state.T)
    rise, width = visible[:, None] * np.exp(above), np.exp(log_width)
    t = (across - place) / width
    step = rise * ndtr(t)
    slope = rise * np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi)
    jacobian = np.stack([-slope / width, step, np.ones_like(t), -slope * t], axis=-1)
    return level - base - step, jacobian
