"""The reported covariance agrees with the scatter over noise."""

import numpy as np
import pytest
from scipy.special import erf

from trinoc.segments import find_segments
from trinoc.segments.nevatia_babu.errors import (
    ErrorModel,
    inflate_variance,
    noise_variance,
)
from trinoc.segments.nevatia_babu.side_slopes import Shifts
from trinoc.segments.tuning import DEFAULT

SEEDS = 60


def edge_image(angle: float, middle: np.ndarray, step: float, blur_px: float) -> np.ndarray:
    v, u = np.mgrid[:64, :64].astype(float)
    distance = (u - middle[0]) * np.cos(angle) + (v - middle[1]) * np.sin(angle)
    return 110.0 + step / 2 * erf(distance / (np.sqrt(2) * blur_px))


@pytest.mark.parametrize(
    ("step", "noise", "blur_px"), [(40.0, 3.0, 0.9), (40.0, 4.0, 1.5), (20.0, 3.0, 1.0)]
)
def test_errors_scatter_as_the_covariance_says(step: float, noise: float, blur_px: float) -> None:
    middles, tilts = [], []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        angle, middle = rng.uniform(0, 2 * np.pi), rng.uniform(28, 35, 2)
        grey = edge_image(angle, middle, step, blur_px) + rng.normal(0, noise, (64, 64))
        segments = find_segments(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
        longest = int(np.argmax(segments.length_px))
        assert segments.length_px[longest] > 30
        normal = np.array([np.cos(angle), np.sin(angle)])
        error = (np.asarray(segments.endpoints_px)[longest] - middle) @ normal
        covariance = np.asarray(segments.covariance_px2)[longest]
        for weights, out in (((0.5, 0.5), middles), ((1.0, -1.0), tilts)):
            row = np.concatenate([weights[0] * normal, weights[1] * normal])
            out.append((np.array(weights) @ error) / np.sqrt(row @ covariance @ row))
    for normalised in (middles, tilts):
        # The spread of a variance from 60 draws is 0.18 of it. The claim allows for what a model
        # of an edge leaves out, which these pictures have none of: it is never too small.
        assert 0.4 < np.mean(np.square(normalised)) < 1.0
        assert np.mean(np.abs(normalised) > 3) < 0.05


def test_the_variance_of_a_line_is_more_than_its_noise_and_never_nothing() -> None:
    """The choice of points and the model error add variance, the latter less on long lines."""
    noise_px2 = np.array([0.0, 0.0, 1e-2, 1e-2])
    variance_px2 = noise_variance(noise_px2, np.array([1e12, 20.0, 1e12, 20.0]))
    assert variance_px2[0] == pytest.approx(DEFAULT.errors.model_sigma_px**2)
    np.testing.assert_allclose(
        variance_px2[2:] - variance_px2[:2], DEFAULT.errors.noise_excess * noise_px2[2:]
    )
    assert DEFAULT.errors.noise_excess > 1
    assert variance_px2[1] - variance_px2[0] == pytest.approx(
        DEFAULT.errors.model_sigma_per_pixel**2 / 20
    )


def test_positions_have_no_bias_toward_either_side() -> None:
    offsets = []
    for index, angle in enumerate(np.linspace(0, 2 * np.pi, 24, endpoint=False)):
        middle = np.array([31.3 + 0.04 * index, 32.1 - 0.03 * index])
        grey = edge_image(angle, middle, 80.0, 0.9)
        segments = find_segments(grey.astype(np.float32))
        longest = int(np.argmax(segments.length_px))
        normal = np.array([np.cos(angle), np.sin(angle)])
        offsets.append(((np.asarray(segments.endpoints_px)[longest] - middle) @ normal).mean())
    assert np.abs(offsets).max() < 0.02
    assert abs(np.mean(offsets)) < 0.004


def test_a_saturated_bright_side_widens_the_covariance_and_says_so() -> None:
    grey = edge_image(0.3, np.array([32.0, 31.0]), 240.0, 1.2) + 120.0
    noise = np.random.default_rng(0).normal(0, 2, grey.shape)
    segments = find_segments(np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8))
    longest = int(np.argmax(segments.length_px))
    assert segments.reasons is not None
    assert segments.reasons[longest] == "saturated"
    clear = find_segments(np.clip(np.rint(0.5 * (grey + noise)), 0, 255).astype(np.uint8))
    normal = np.array([np.cos(0.3), np.sin(0.3)] * 2) / 2
    saturated_variance, clear_variance = (
        normal @ np.asarray(detected.covariance_px2)[int(np.argmax(detected.length_px))] @ normal
        for detected in (segments, clear)
    )
    assert saturated_variance > 4 * clear_variance


def test_a_saturated_edge_lies_within_its_sigmas_of_where_it_is() -> None:
    for blur, above_white in ((0.7, 100.0), (1.2, 60.0), (2.0, 40.0)):
        middle = np.array([32.0, 31.0])
        # Dark 60, bright white and more.
        grey = edge_image(0.3, middle, 195.0 + above_white, blur)
        grey = grey - grey.min() + 60.0
        noise = np.random.default_rng(0).normal(0, 2, grey.shape)
        segments = find_segments(np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8))
        longest = int(np.argmax(segments.length_px))
        ends = np.asarray(segments.endpoints_px)[longest]
        normal = np.array([np.cos(0.3), np.sin(0.3)])
        half = np.concatenate([normal, normal]) / 2
        sigma = np.sqrt(half @ np.asarray(segments.covariance_px2)[longest] @ half)
        assert abs(((ends - middle) @ normal).mean()) < 3 * sigma


def test_noise_on_a_slope_is_no_edge() -> None:
    v, _ = np.mgrid[:128, :128].astype(float)
    noise = np.random.default_rng(1).normal(0, 3, v.shape)
    slope = 60.0 + np.clip(2.5 * (v - 30), 0, 150)
    segments = find_segments(np.clip(np.rint(slope + noise), 0, 255).astype(np.uint8))
    middle = np.asarray(segments.endpoints_px).mean(axis=1)
    within = (middle[:, 1] > 40) & (middle[:, 1] < 80)
    assert within.sum() <= 2


def test_two_edges_side_by_side_stay_within_their_sigmas() -> None:
    v, u = np.mgrid[:64, :64].astype(float)
    normal = np.array([np.cos(0.2), np.sin(0.2)])
    distance = (u - 31.4) * normal[0] + (v - 31.8) * normal[1]
    half_width = 2.2
    bar = erf((distance + half_width) / 1.1) - erf((distance - half_width) / 1.1)
    segments = find_segments((80.0 + 50.0 * bar).astype(np.float32))
    long = np.flatnonzero(np.asarray(segments.length_px) > 30)
    offsets = ((np.asarray(segments.endpoints_px)[long] - [31.4, 31.8]) @ normal).mean(axis=1)
    row = np.concatenate([normal, normal]) / 2
    sigma = np.sqrt(row @ np.asarray(segments.covariance_px2)[long] @ row)
    assert len(long) == 2
    error = np.sort(offsets) - [-half_width, half_width]
    assert (np.abs(error) < 3 * sigma).all()
    # They push each other apart; what is left of it is less than a tenth of a pixel.
    assert np.abs(error).max() < 0.1


def test_what_disturbs_a_line_widens_it_and_is_named() -> None:
    nothing, one = np.zeros(5), np.ones(1)
    pull, crowded, bow, scatter = np.eye(5)[1:]
    disturbed = ErrorModel(pull, crowded, nothing, bow, scatter, np.zeros((5, 2)))
    calm = Shifts(nothing, nothing)
    noise_px2 = np.full(5, 1e-4)
    variance, common, reasons = inflate_variance(disturbed, noise_px2, calm, calm)
    errors = DEFAULT.errors
    sizes = [0.0, 1.0, errors.crowd_px, errors.bow_share, errors.scatter_share]
    # A neighbour all along a line moves it as a whole, and turns it by less.
    turning = [1, 1, errors.turn_share, 1, 1]
    np.testing.assert_allclose(variance - noise_px2, turning * np.square(sizes))
    np.testing.assert_allclose(common, [0, 0, errors.crowd_px**2, 0, 0])
    assert reasons.tolist() == ["", "neighbour", "neighbour", "bent", "bent"]
    shifted = Shifts(one, one)
    alone = ErrorModel(*(part[:1] for part in disturbed))
    for saturated, shaded, name in ((shifted, calm, "saturated"), (calm, shifted, "shaded")):
        first, second = (Shifts(*(part[:1] for part in shifts)) for shifts in (saturated, shaded))
        variance, common, reasons = inflate_variance(alone, noise_px2[:1], first, second)
        assert (variance, common) == (noise_px2[0], 1.0)
        assert reasons.tolist() == [name]
