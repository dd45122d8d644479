"""The rate of false alarms of the one test, from the picture itself.

The sum of a ridge over a window is compared with its standard deviation. Noise of cameras is nearly
white; compression, denoising and texture are not, and windows of them sum up to more. How much more
is measured on control probes, at random in the same picture: g(n) for each size of window, from the
median of the sums' sizes, which the edges that controls meet do not move.
"""

import numpy as np
from jaxtyping import Float

from trinoc.geometry import Intrinsics
from trinoc.match.pixels.probes import (
    NEXT,
    SECOND,
    SHOULDER,
    SMOOTHING_PX,
    STEP_PX,
    STEPS,
    WINDOW_SIZE,
    WINDOWS,
    Gradient,
    samples_of,
    window_scores,
)
from trinoc.numerics import MAD_TO_SIGMA, log_normal_tail, log_student_tail

CONTROLS = 128
# Blocks of a probe tell their sigma like so many independent ones; below this excess it is chance.
DEGREES = 12
KNOWN_BELOW = 1.3


def block_noise(gradient: Gradient) -> float:
    """Standard deviation of a block's ridge from the noise of the picture, at the least step."""
    wide = SMOOTHING_PX
    along = np.exp(-((STEP_PX / wide) ** 2) / 4)

    def across(apart: float) -> float:
        return float((1 - apart**2 / (2 * wide**2)) * np.exp(-((apart / wide) ** 2) / 4))

    shoulders = 1.5 - 2 * across(SHOULDER) + 0.5 * across(2 * SHOULDER)
    return float(gradient.noise * np.sqrt((1 + along) / 2 * shoulders))


def growth_of(
    gradient: Gradient, lens: Intrinsics, size_px: tuple[int, int], controls: int = CONTROLS
) -> Float[np.ndarray, "k"]:
    """g(n) for every size of window, at least that of white noise, from control probes."""
    rng = np.random.default_rng(0)
    size = np.array(size_px, dtype=np.float64)
    length = min(STEPS * STEP_PX, 0.6 * float(size.min()))
    middle = rng.uniform(0.35 * length, size - 0.35 * length, (controls, 2))
    angle = rng.uniform(0, np.pi, controls)
    half = 0.5 * length * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places = samples_of(np.stack([middle - half, middle + half], axis=1), lens, size_px)
    scores, complete = window_scores(gradient.by_uv, max(block_noise(gradient), 1e-3), places)
    growth = white_growth()
    for k, window in enumerate(WINDOWS):
        column = window == WINDOW_SIZE
        values = np.abs(scores[:, column][complete[:, column]])
        if len(values) > 20:
            growth[k] = max(growth[k], (MAD_TO_SIGMA * np.median(values)) ** 2)
    return np.maximum.accumulate(growth)


def white_growth() -> Float[np.ndarray, "k"]:
    """g(n) of white noise: neighbouring blocks share a little of it."""
    sizes = np.array(WINDOWS, dtype=np.float64)
    return 1 + 2 * NEXT * (sizes - 1) / sizes + 2 * SECOND * (sizes - 2) / sizes


def log_chance(score: Float[np.ndarray, "n"], excess: Float[np.ndarray, "n"]) -> np.ndarray:
    """Natural logarithm of the probability that noise scores as much in one test, two-sided.

    Where blocks scatter as the picture's noise says, their sigma is known; where they scatter more
    (`excess`), it is an estimate from few, and the score is one of Student's.
    """
    known = log_normal_tail(score)
    estimated = log_student_tail(score, DEGREES)
    return np.log(2) + np.where(excess > KNOWN_BELOW, np.maximum(estimated, known), known)
