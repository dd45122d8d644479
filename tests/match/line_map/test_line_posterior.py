"""The posterior of a line from segments with unknown error factors agrees with a brute integration,
and the difference of two lines with the normal distribution."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from trinoc.match.line_map.collinearity import difference
from trinoc.match.line_map.line_posterior import _Equations, _line_posterior
from trinoc.match.tuning.every_group import DEFAULT


@pytest.mark.parametrize("seed", range(3))
def test_the_mixture_of_fits_has_the_moments_of_the_integrated_likelihood(seed: int) -> None:
    rng = np.random.default_rng(seed)
    residual, jacobian = rng.normal(size=(3, 2)) * 2, rng.normal(size=(3, 2, 4))
    # The first two segments determine the line; the third says whether they agree.
    jacobian[0], jacobian[1] = np.eye(4)[:2], np.eye(4)[2:]
    scales, shares = np.array([1.0, 1.7, 3.0]), np.array([0.5, 0.3, 0.2])
    axis = np.arange(-14.0, 14.01, 1.0)
    grid = np.stack(np.meshgrid(*[axis] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    density = np.ones(len(grid))
    for segment_residual, slope in zip(residual, jacobian, strict=True):
        square = ((segment_residual + grid @ slope.T) ** 2).sum(axis=1)
        terms = shares / scales**2 * np.exp(-square[:, None] / (2 * scales**2))
        density *= terms.sum(axis=1)
    density /= density.sum()
    mean = density @ grid
    covariance = (density[:, None] * (grid - mean)).T @ (grid - mean)

    answer = _line_posterior(
        _Equations(
            np.array([0]),
            (jacobian.mT @ jacobian)[None],
            (jacobian.mT @ residual[..., None])[None, ..., 0],
            (residual**2).sum(axis=1)[None],
        ),
        shares[None],
        scales,
    )
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(answer.offset[0], mean, atol=0.02 * sigma.min())
    relative_difference = (answer.covariance[0] - covariance) / np.outer(sigma, sigma)
    assert np.abs(relative_difference).max() < 0.02


def test_lines_abreast_differ_by_a_normal_vector_of_both_covariances() -> None:
    first = np.array([[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]])
    second = first + np.array([[0.0, 0.3, 0.1], [0.0, -0.2, 0.4]])
    variances = 0.04, 0.09
    covariances = [variance * np.eye(6)[None] for variance in variances]
    normal = dataclasses.replace(DEFAULT.evidence, outlier_share=1e-300)
    line_difference = difference(first, covariances[0], second, covariances[1], normal)
    offset = (second - first)[0, :, 1:]
    # The common direction leans by a hundredth: places and axes are those of `first` nearly.
    sigma = np.sqrt(sum(variances))
    spread = stats.norm.logpdf(offset, scale=sigma)
    shift = stats.norm.logpdf(offset.mean(axis=0), scale=sigma / np.sqrt(2))
    np.testing.assert_allclose(
        line_difference.square, (offset**2).sum() / sum(variances), rtol=0.02
    )
    np.testing.assert_allclose(line_difference.log_density, spread.sum(), rtol=0.02)
    np.testing.assert_allclose(line_difference.log_shift_density, shift.sum(), rtol=0.1)
    np.testing.assert_allclose(line_difference.shift_sigma, np.sqrt(sum(variances) / 2), rtol=0.02)
    np.testing.assert_allclose(line_difference.span, 10.0, rtol=0.01)
