"""Edges with a saturated bright side lie at the true position within their sigmas."""

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from trinoc.geometry.segments import Segments
from trinoc.segments import find_segments
from trinoc.segments.nevatia_babu.errors import end_covariances

NORMAL = np.array([np.cos(0.3), np.sin(0.3)])
MIDDLE = np.array([32.2, 31.4])


def picture(height: float, width_px: float, *, seed: int, reference: bool) -> np.ndarray:
    """A step from 50 by `height` times the visible range, and clear stripes if `reference`."""
    v, u = np.mgrid[:72, :72].astype(float)
    across = (u - MIDDLE[0]) * NORMAL[0] + (v - MIDDLE[1]) * NORMAL[1]
    grey = 50 + 205 * height * ndtr(across / width_px)
    if reference:
        for centre_px, step in ((-10, -25), (-17, 25), (-25, -25), (-32, 25)):
            grey = grey + step * ndtr((across - centre_px) / width_px)
    grey = grey + np.random.default_rng(seed).normal(0, 1.5, grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def longest_edge(segments: Segments) -> tuple[np.ndarray, np.ndarray, str]:
    """Offsets of both ends toward the bright side, px, their covariance, px^2, and the reason."""
    ends = np.asarray(segments.endpoints_px)
    is_near = np.abs((ends - MIDDLE) @ NORMAL).max(axis=1) < 4
    index = int(np.argmax(np.where(is_near, segments.length_px, 0)))
    rows = np.kron(np.eye(2), NORMAL)
    covariance = rows @ np.asarray(segments.covariance_px2)[index] @ rows.T
    assert segments.reasons is not None
    return (ends[index] - MIDDLE) @ NORMAL, covariance, str(segments.reasons[index])


@pytest.mark.parametrize("width_px", [0.8, 1.2, 1.6])
@pytest.mark.parametrize("height", [1.1, 1.4, 2.0, 3.0])
def test_a_saturated_edge_lies_within_its_sigmas_and_near_the_truth(
    height: float, width_px: float
) -> None:
    off, covariance, reason = longest_edge(
        find_segments(picture(height, width_px, seed=1, reference=True))
    )
    assert reason == "saturated"
    sigma = np.sqrt(covariance.mean())
    assert abs(off.mean()) < 2.5 * sigma
    # Left where it is seen, it would be off by up to 1.1 widths.
    assert abs(off.mean()) < 0.2 * width_px
    assert sigma < 0.25 * width_px


def test_the_scatter_of_saturated_edges_is_no_more_than_is_claimed() -> None:
    pulls = []
    for seed in range(12):
        off, covariance, _ = longest_edge(
            find_segments(picture(1.2 + 0.1 * seed, 1.0, seed=seed, reference=True))
        )
        pulls.append(off.mean() / np.sqrt(covariance.mean()))
    assert np.mean(np.square(pulls)) < 1.5


def test_what_a_saturated_edge_is_off_by_its_ends_have_in_common() -> None:
    _, covariance, _ = longest_edge(find_segments(picture(2.0, 1.2, seed=0, reference=True)))
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    # Noise alone makes it -1/2.
    assert correlation > 0.3


def test_without_another_edge_the_blur_is_less_known_and_the_sigma_larger() -> None:
    alone, with_reference = (
        longest_edge(find_segments(picture(2.0, 1.2, seed=3, reference=reference)))
        for reference in (False, True)
    )
    assert alone[1].mean() > with_reference[1].mean()
    assert abs(alone[0].mean()) < 3 * np.sqrt(alone[1].mean())


def test_the_parts_of_a_covariance_add_up() -> None:
    direction, middle = np.array([[0.6, 0.8]]), np.array([0.01])
    common, off, along = np.array([0.04]), np.array([[0.0, 0.09]]), np.array([[0.5, 2.0]])
    covariance = end_covariances(direction, middle, common, off, along)[0]
    across, forward = np.array([-0.8, 0.6]), direction[0]
    rows = np.kron(np.eye(2), across)
    expected = np.array([[0.04 + 0.04, 0.04 - 0.02], [0.04 - 0.02, 0.04 + 0.04 + 0.09]])
    np.testing.assert_allclose(rows @ covariance @ rows.T, expected, atol=1e-12)
    rows = np.kron(np.eye(2), forward)
    np.testing.assert_allclose(rows @ covariance @ rows.T, np.diag([0.25, 4.0]), atol=1e-12)
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_an_edge_with_no_level_below_white_has_finite_errors_without_a_warning() -> None:
    grey = np.full((300, 300), 247.0)
    grey[140:291, 150:291] = 300
    grey[20:121, 20:121] = 20
    grey = cv2.GaussianBlur(grey, (0, 0), 4.0) + np.random.default_rng(0).normal(0, 3, grey.shape)
    segments = find_segments(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
    assert np.isfinite(segments.endpoints_px).all()
    assert (np.linalg.eigvalsh(segments.covariance_px2) > 0).all()
    assert (np.asarray(segments.endpoints_px).mean(axis=(1, 2)) > 135).any()
