"""Laws of the extended model's parts: response, kernels, saturation, noise, local light."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter
from scipy.stats import norm

from tests.calib.photometric.pictures import RIGHT, pose_of
from tests.calib.simulated import LENS, reference_sheet
from trinoc.calib.photometric.edges import Kernel, coverage, straight_edge
from trinoc.calib.photometric.encoding import Encoding, balance_mosaic
from trinoc.calib.photometric.grey_level import Tone, grey_level
from trinoc.calib.photometric.noise import (
    PixelGrid,
    Saturation,
    autocorrelation,
    clipped_moments,
    noise_by_level,
    saturation_level,
    sum_correlated,
)
from trinoc.calib.photometric.sheet_geometry import SheetPoint, project_to_image
from trinoc.errors import InputError


def test_grey_levels_of_paper_and_ink_do_not_follow_the_response() -> None:
    """Light and ratio are grey levels. The response shapes only the levels in between."""
    white, paper = jnp.asarray(255.0), jnp.asarray(200.0)
    for bend in (0.0, 0.7, 1.5):
        tone = Tone(*(jnp.asarray(value) for value in (-0.8, bend, 0.0, 0.0, 0.0)))
        levels = [
            float(grey_level(jnp.asarray(share), paper, jnp.asarray(0.0), paper, white, tone))
            for share in (0.0, 1.0)
        ]
        assert levels == pytest.approx([200.0, 40.0], rel=1e-6)


def share_of_edge(distance_px: float, kernel: Kernel, angle: float) -> float:
    """Coverage of a straight edge whose normal has the angle `angle` to u, at one mm per pixel."""
    one = jnp.asarray(1.0)
    normal = np.array([np.cos(angle), np.sin(angle)])
    point = SheetPoint(
        jnp.asarray(distance_px * normal), jnp.eye(2), jnp.zeros(2), jnp.ones(3), one
    )
    across, down = (jnp.asarray(part) for part in normal)
    edge = straight_edge(point, across, down, jnp.asarray(0.0))
    return float(coverage(edge, jnp.asarray(0.0), kernel).share)


def kernel_of(**nonzero: float) -> Kernel:
    values = dict.fromkeys(Kernel._fields, 0.0) | nonzero
    return Kernel(**{name: jnp.asarray(value) for name, value in values.items()})


@pytest.mark.parametrize("angle_deg", [0.0, 25.0, 60.0, 115.0])
def test_kernel_of_a_motion_is_a_gaussian_along_a_line(angle_deg: float) -> None:
    sigma, length, direction = 0.9, 2.0, np.radians(25.0)
    amount = length**2 / 24
    kernel = kernel_of(
        sigma_px=np.sqrt(sigma**2 + amount),
        along_u=amount * np.cos(2 * direction),
        diagonal=amount * np.sin(2 * direction),
        line=1.0,
    )
    angle = np.radians(angle_deg)
    half = 0.5 * length * abs(np.cos(angle - direction)) + 1e-9
    for distance in np.linspace(-3, 3, 13):
        exact = quad(lambda x, d=distance: norm.cdf(-(d + x) / sigma), -half, half)[0] / (2 * half)
        assert share_of_edge(distance, kernel, angle) == pytest.approx(exact, abs=2e-3)


def test_kernel_of_a_disc_is_flat_topped() -> None:
    """Compare with a Gaussian and a disc blurred numerically, by cumulants -R^4/16 and R^6/16."""
    sigma, radius = 0.7, 1.2
    variance = sigma**2 + radius**2 / 4
    kernel = kernel_of(
        sigma_px=np.sqrt(variance),
        kurtosis=-(radius**4) / 16 / variance**2,
        sixth=5 * radius**6 / 64 / variance**3,
    )

    def exact(distance: float) -> float:
        def density(x: float) -> float:
            return 2 * np.sqrt(max(radius**2 - x * x, 0)) / (np.pi * radius**2)

        return quad(lambda x: density(x) * norm.cdf(-(distance + x) / sigma), -radius, radius)[0]

    for distance in np.linspace(-2.5, 2.5, 11):
        assert share_of_edge(distance, kernel, 0.3) == pytest.approx(exact(distance), abs=2e-3)


@settings(max_examples=30, deadline=None)
@given(st.floats(230.0, 275.0), st.floats(0.5, 5.0))
def test_moments_of_a_clipped_level(level: float, sigma: float) -> None:
    top, clipped_sigma = 255.0, 0.2
    got = clipped_moments(np.array([level]), np.array([sigma]), Saturation(top, clipped_sigma))
    levels = level + sigma * np.linspace(-9, 9, 40001)
    weight = norm.pdf(levels, level, sigma) * (levels[1] - levels[0])
    cut = np.minimum(levels, top)
    mean = weight @ cut
    assert got.mean[0] == pytest.approx(mean, abs=1e-3)
    assert got.slope[0] == pytest.approx(norm.cdf((top - level) / sigma), abs=1e-9)
    noise_floor = clipped_sigma**2 * norm.sf((top - level) / sigma)
    assert got.sigma[0] ** 2 == pytest.approx(weight @ (cut - mean) ** 2 + noise_floor, abs=2e-3)


def test_saturation_is_where_levels_pile_up() -> None:
    grey = np.random.default_rng(0).normal(200.0, 30.0, 20000)
    assert saturation_level(np.minimum(grey, 230.0), 0.002) == 230.0
    assert saturation_level(grey, 0.002) == np.inf


def test_noise_grows_with_the_level_as_it_was_made() -> None:
    random = np.random.default_rng(1)
    level = random.uniform(20, 230, 40000)
    sigma = np.sqrt(1 + level / 20)
    residual = random.normal(0, sigma)
    everything = np.ones(len(level), dtype=bool)
    test_levels = np.linspace(40, 210, 9)
    for robust in (False, True):
        sigmas = noise_by_level(level, residual, everything, test_levels, 30, robust=robust)
        assert sigmas == pytest.approx(np.sqrt(1 + test_levels / 20), rel=0.05)


def test_noise_of_few_pixels_is_one_value_for_all_levels() -> None:
    residual = np.array([-2.0, 1.0, 3.0, -1.0])
    level, queries = np.array([10.0, 80.0, 150.0, 220.0]), np.array([0.0, 100.0, 255.0])
    for fewest in (2, 30):
        sigma = noise_by_level(level, residual, np.ones(4, dtype=bool), queries, fewest)
        np.testing.assert_allclose(sigma, np.full(3, residual.std()))


def test_correlation_and_the_variance_of_a_sum() -> None:
    random = np.random.default_rng(2)
    row, column = (part.ravel() for part in np.mgrid[:120, :140])
    grid, everything = PixelGrid(column, row, 4), np.ones(120 * 140, dtype=bool)
    white = random.normal(size=(120, 140))
    total = autocorrelation(grid, white.ravel(), everything, 3.0).sum()
    assert total == pytest.approx(1.0, abs=0.2)
    smooth = gaussian_filter(white, 0.8)
    shared = autocorrelation(grid, smooth.ravel() / smooth.std(), everything, 3.0)
    lags = np.arange(-4, 5)
    squares = lags[:, None] ** 2 + lags**2
    assert shared == pytest.approx(np.exp(-squares / (4 * 0.8**2)), abs=0.05)
    # The sum over a window of the noise has the variance that the sandwich says.
    wave = np.cos(column / 9.0) * np.cos(row / 7.0)
    predicted_variance = sum_correlated(grid, wave[None], shared)[0, 0]
    sums = [
        wave @ (gaussian_filter(random.normal(size=(120, 140)), 0.8) / smooth.std()).ravel()
        for _ in range(200)
    ]
    assert np.var(sums) / predicted_variance == pytest.approx(1.0, abs=0.35)


def test_a_mosaic_is_brought_to_the_levels_of_green() -> None:
    pattern, pose = reference_sheet(), pose_of(RIGHT)
    row, column = np.mgrid[:480, :512] % 2
    gain = np.array([[0.55, 1.0], [1.0, 0.65]])[row, column]
    flat = np.full((480, 512), 200.0)
    centres = np.asarray(project_to_image(pose, LENS.lens, pattern.centres_mm))
    inked = np.asarray(
        [np.hypot(*(np.indices(flat.shape)[::-1] - uv[:, None, None])) < 9 for uv in centres]
    ).any(axis=0)
    picture = np.where(inked, 30.0, flat)
    balanced = balance_mosaic(
        (picture * gain).astype(np.float32), "RGGB", pose, LENS.lens, pattern, 30
    )
    assert np.allclose(balanced.image, picture, atol=1.0)
    assert np.allclose(balanced.noise_scale * gain, 1.0, atol=0.01)


@pytest.mark.parametrize("encoding", [Encoding(bayer="RGB"), Encoding(response="gamma")])  # type: ignore[arg-type]
def test_unknown_encodings_are_refused(encoding: Encoding) -> None:
    with pytest.raises(InputError, match=": give"):
        encoding.check()
