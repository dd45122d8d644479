"""The covariance of fitted positions equals that of the noise, in small and in noisy windows."""

import numpy as np

from trinoc.calib.detection.window_noise import WindowPixels, sandwich_covariance
from trinoc.calib.tuning.every_group import TUNING

RADIUS_PX, SPREAD_PX = 4, 1.3


def fitted_covariance(noise_sigma: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(covariance of each window's position, that of independent noise of variance 1).

    Each window shows a spot, to which position, height and background are fitted; its noise is
    independent, with a standard deviation for each window.
    """
    count, side = len(noise_sigma), 2 * RADIUS_PX + 1
    row, column = (axis.ravel() for axis in np.mgrid[:side, :side])
    u, v = column - RADIUS_PX, row - RADIUS_PX
    spot = np.exp(-(u**2 + v**2) / (2 * SPREAD_PX**2))
    jacobian = np.stack([u * spot, v * spot, spot, np.ones_like(spot)], axis=1)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    noise = np.random.default_rng(seed).normal(size=(count, len(u))) * noise_sigma[:, None]
    residual = noise - noise @ jacobian @ covariance @ jacobian.T

    def of_each(values: np.ndarray) -> np.ndarray:
        return np.broadcast_to(values, (count, *values.shape)).copy()

    pixels = WindowPixels(side, of_each(column), of_each(row), np.ones(noise.shape, dtype=bool))
    centre = np.full((count, 2), float(RADIUS_PX))
    jacobian, covariance = of_each(jacobian).astype(np.float32), of_each(covariance)
    estimate = sandwich_covariance(
        pixels, centre, residual.astype(np.float32), jacobian, covariance, (0, 1), TUNING
    )
    return estimate, covariance[:, :2, :2]


def test_a_position_has_the_variance_of_independent_noise_in_a_small_window() -> None:
    """The middle pixels of a window lie beside those across it, whose noise is the same."""
    estimate, white = fitted_covariance(np.full(4000, 3.0))
    ratio = estimate[:, 0, 0].mean() / (9.0 * white[0, 0, 0])
    # So few pixels tell the noise of one window poorly, and the limit of what one window counts
    # takes some hundredths off the mean.
    assert abs(ratio - 1) < 0.1


def test_a_far_noisier_window_has_a_larger_covariance_and_enlarges_no_other() -> None:
    alone, _ = fitted_covariance(np.ones(300))
    sigma = np.ones(300)
    sigma[7] = 20.0
    estimate, _ = fitted_covariance(sigma)
    enlarged = estimate[:, 0, 0] / alone[:, 0, 0]
    assert enlarged[7] > 10
    assert np.abs(np.delete(enlarged, 7) - 1).max() < 0.1
