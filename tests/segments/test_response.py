"""Edges lie at their positions in the light, whatever the camera's response is."""

import numpy as np
import pytest
from scipy.special import erf

from simulation.camera_picture.delivery import SRGB
from trinoc.image.response import PowerResponse
from trinoc.segments import find_segments

ANGLES = np.arange(8) * np.pi / 4 + 0.13


def across(angle: float, middle: np.ndarray) -> np.ndarray:
    v, u = np.mgrid[:56, :56].astype(float)
    return (u - middle[0]) * np.cos(angle) + (v - middle[1]) * np.sin(angle)


def step(distance: np.ndarray, dark: float, bright: float, width_px: float) -> np.ndarray:
    return dark + (bright - dark) / 2 * (1 + erf(distance / (np.sqrt(2) * width_px)))


def srgb(light: np.ndarray) -> np.ndarray:
    return SRGB().encode(light)


def bent(light: np.ndarray) -> np.ndarray:
    return np.asarray(PowerResponse(0.5).level_of(light))


def delivered(light: np.ndarray, encoded=srgb, noise: float = 1.5) -> np.ndarray:
    levels = 255 * encoded(light)
    levels = levels + np.random.default_rng(5).normal(0, noise, light.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def offsets(dark: float, bright: float, width_px: float, response, *, encoded=srgb) -> np.ndarray:
    """(angles, 2) offset of the edge toward its bright side, in px and in reported sigmas."""
    rows = []
    for angle in ANGLES:
        middle = np.array([27.3, 28.1]) + 0.3 * np.array([np.sin(5 * angle), np.cos(7 * angle)])
        image = delivered(step(across(angle, middle), dark, bright, width_px), encoded)
        segments = find_segments(image, response=response)
        longest = int(np.argmax(segments.length_px))
        normal = np.array([np.cos(angle), np.sin(angle)])
        half = np.concatenate([normal, normal]) / 2
        off = ((np.asarray(segments.endpoints_px)[longest] - middle) @ normal).mean()
        sigma = np.sqrt(half @ np.asarray(segments.covariance_px2)[longest] @ half)
        rows.append((off, off / sigma))
    return np.array(rows)


@pytest.mark.parametrize(
    ("dark", "bright", "width_px", "moved"),
    [(0.02, 0.9, 1.0, 0.58), (0.05, 0.5, 1.6, 0.4), (0.2, 0.4, 0.8, 0.12), (0.02, 0.9, 2.1, 0.63)],
)
def test_srgb_moves_an_edge_toward_dark_and_is_undone(
    dark: float, bright: float, width_px: float, moved: float
) -> None:
    without, with_response = (offsets(dark, bright, width_px, r) for r in ("linear", "srgb"))
    assert without[:, 0].mean() / width_px == pytest.approx(-moved, abs=0.04)
    assert np.abs(with_response[:, 0]).max() < 0.045
    assert abs(with_response[:, 0].mean()) < 0.015
    assert np.mean(np.square(with_response[:, 1])) < 1.6


def test_other_responses_are_given_by_a_number() -> None:
    assert np.abs(offsets(0.1, 0.7, 1.2, 0.5, encoded=bent)[:, 0]).max() < 0.03


def test_a_response_of_zero_is_linear_to_the_last_bit() -> None:
    image = delivered(step(across(0.4, np.array([28.0, 27.0])), 0.1, 0.8, 1.0))
    linear, zero = find_segments(image), find_segments(image, response=0.0)
    np.testing.assert_array_equal(linear.endpoints_px, zero.endpoints_px)
    np.testing.assert_array_equal(linear.covariance_px2, zero.covariance_px2)


def test_two_edges_side_by_side_are_parted_in_light() -> None:
    distance, half_width = across(0.2, np.array([27.4, 27.8])), 2.4
    bar = step(distance + half_width, 0.03, 0.6, 0.8) - step(distance - half_width, 0, 0.57, 0.8)
    normal = np.array([np.cos(0.2), np.sin(0.2)])
    off = {}
    for response in ("linear", "srgb"):
        segments = find_segments(delivered(bar), response=response)
        long = np.flatnonzero(np.asarray(segments.length_px) > 30)
        assert len(long) == 2
        positions_px = ((np.asarray(segments.endpoints_px)[long] - [27.4, 27.8]) @ normal).mean(
            axis=1
        )
        off[response] = np.abs(np.sort(positions_px) - [-half_width, half_width]).max()
    assert off["linear"] > 0.2
    assert off["srgb"] < 0.1
