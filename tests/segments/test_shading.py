"""Slopes of grey levels beside an edge: effect on its position and its reported sigma."""

import cv2
import numpy as np
import pytest

from trinoc.geometry.segments import Segments
from trinoc.numerics.tables import with_field
from trinoc.segments import find_segments
from trinoc.segments.tuning import DEFAULT

SIDE, STEP, BLUR_PX = 160, 30.0, 1.0
UNSHADED = with_field(DEFAULT, "errors.shade_share", 0.0)


def shaded_edge(angle_deg: float, dark: float, bright: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture of an edge through the middle and unit vector toward its bright side. The grey levels
    have these slopes, per pixel, on either side up to 12 px away."""
    across = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    v, u = (np.mgrid[: 4 * SIDE, : 4 * SIDE] + 0.5) / 4 - 0.5 - (SIDE - 1) / 2
    x = u * across[0] + v * across[1]
    grey = 100 + STEP * (x > 0) + bright * np.clip(x, 0, 12) + dark * np.clip(x, -12, 0)
    grey = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 4 * BLUR_PX)
    grey = cv2.resize(grey, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(0).normal(0, 1.0, grey.shape)
    return np.rint(grey + noise).astype(np.uint8), across


def longest(segments: Segments, across: np.ndarray) -> tuple[float, float, str]:
    """(offset toward the bright side, its reported sigma, reason) of the longest segment."""
    ends = np.asarray(segments.endpoints_px)
    best = int(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).argmax())
    offset = float((ends[best].mean(axis=0) - (SIDE - 1) / 2) @ across)
    half = np.tile(across, 2) / 2
    sigma = np.sqrt(half @ np.asarray(segments.covariance_px2)[best] @ half)
    assert segments.reasons is not None
    return offset, float(sigma), str(segments.reasons[best])


@pytest.mark.parametrize("angle_deg", [20.0, 110.0, 250.0])
@pytest.mark.parametrize(("dark", "bright"), [(0.0, 1.2), (1.2, 0.0)])
def test_a_slope_on_one_side_moves_an_edge_less_than_it_would_and_as_far_as_is_claimed(
    angle_deg: float, dark: float, bright: float
) -> None:
    picture, across = shaded_edge(angle_deg, dark, bright)
    uncorrected, _, _ = longest(find_segments(picture, tuning=UNSHADED), across)
    offset, sigma, reason = longest(find_segments(picture), across)
    assert uncorrected * (bright - dark) > 0
    assert abs(offset) < abs(uncorrected)
    assert abs(offset) < 3 * sigma
    assert reason == "shaded"


def test_an_edge_between_even_sides_stays_where_it_is() -> None:
    picture, across = shaded_edge(20.0, 0.0, 0.0)
    uncorrected, uncorrected_sigma, _ = longest(find_segments(picture, tuning=UNSHADED), across)
    offset, sigma, _ = longest(find_segments(picture), across)
    assert offset == pytest.approx(uncorrected, abs=0.01)
    assert sigma == pytest.approx(uncorrected_sigma, abs=0.01)
