"""Laws of the image model: agreement with integration, differences and rendered images."""

import numpy as np
import pytest

from tests.calib.photometric.pictures import (
    RIGHT,
    drawing_of,
    image_of,
    pixels_of,
    pose_of,
    rows_of,
    state_at,
    with_appearance,
)
from tests.calib.simulated import LENS, reference_sheet
from trinoc.calib.photometric.image_fit import ImageRefinement, refine_image
from trinoc.calib.photometric.sheet_geometry import sheet_from_camera
from trinoc.calib.photometric.unknowns import ImageState, full_state
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.pose import PoseModel


def model_residuals(pattern: Pattern, values: tuple[float, ...]) -> list[np.ndarray]:
    """Model minus picture at the true pose, near circles and near lines."""
    picture, residuals = image_of(pattern, values), []
    for near_line in (False, True):
        group, count = pixels_of(picture, pattern, near_line=near_line)
        rows = rows_of(state_at(values), group, drawing=drawing_of(pattern), near_line=near_line)
        residuals.append((np.asarray(rows.level) - group.pixels.grey)[:count])
    return residuals


@pytest.mark.parametrize(
    ("rings", "style"),
    [
        ("code", "through"),
        *(
            pytest.param(rings, style, marks=pytest.mark.slow)
            for rings, style in (
                ("none", "stop"),
                ("none", "through"),
                ("none", "white"),
                ("code", "white"),
                ("code", "stop"),
            )
        ),
    ],
)
def test_model_is_the_picture(rings: str, style: str) -> None:
    pattern = Pattern.cross_grid(
        rows=5,
        columns=5,
        pitch_mm=20.0,
        radius_mm=6.0,
        rings=rings,  # pyright: ignore[reportArgumentType]
        line_style=style,
        line_half_length_mm=(55.0, 55.0),
    )
    for residual in model_residuals(pattern, RIGHT):
        assert len(residual) > 1000
        # A fifth of the noise of the reference scene; the renderer's own steps are half of it.
        assert np.sqrt(np.mean(residual**2)) < 0.4
        assert abs(np.mean(residual)) < 0.05


STATES = {
    "ideal": with_appearance(state_at(RIGHT), spread_mm=0.02),
    "delivered": with_appearance(
        full_state(state_at(RIGHT), TUNING.photometric),
        kurtosis=0.1,
        along_u=0.1,
        diagonal=-0.05,
        line=0.5,
        lobe=0.3,
        bend=0.6,
        lift=0.05,
        contrast=0.1,
        spread_mm=0.02,
        lobe_mm=0.05,
    ),
}


@pytest.mark.parametrize(
    ("kind", "near_line"),
    [
        # Near circles the ideal camera's are the delivered one's, which another test holds.
        pytest.param("ideal", False, marks=pytest.mark.slow),
        ("ideal", True),
        ("delivered", False),
        pytest.param("delivered", True, marks=pytest.mark.slow),
    ],
)
def test_derivatives_are_those_of_differences(kind: str, near_line: bool) -> None:
    pattern, state = reference_sheet(), STATES[kind]
    picture = np.zeros(LENS.image_size_px[::-1])
    group, _ = pixels_of(picture, pattern, near_line=near_line)
    homography = np.asarray(sheet_from_camera(state.pose))
    still = {"drawing": drawing_of(pattern), "near_line": near_line}

    def level(turn: np.ndarray, change: np.ndarray) -> np.ndarray:
        values = np.asarray(state.values) + change
        moved = ImageState(state.pose, values, state.levels, state.unknowns)
        return np.asarray(rows_of(moved, group, homography + turn, **still).level)

    rows = np.asarray(rows_of(state, group, homography, **still).rows)
    for k, row in enumerate(rows):
        turn, change = np.zeros((3, 3)), np.zeros(state.unknowns.size)
        if k < 9:
            step = 1e-5 * max(abs(homography.flat[k]), 1e-2)
            turn.flat[k] = step
        else:
            step = 1e-5 if k - 9 < len(state.unknowns.appearance) else 1e-2
            change[k - 9] = step
        exact = (level(turn, change) - level(-turn, -change)) / (2 * step)
        # Directions and curvatures are held, and of the response the light in the middle: a few
        # percent of a row, and less over all.
        if k - 9 == state.unknowns.light[0] and kind == "delivered":
            continue
        error = np.sqrt(np.mean((row - exact) ** 2))
        assert error < 0.04 * np.sqrt(np.mean(exact**2)) + 1e-6, k


@pytest.mark.parametrize("near_line", [pytest.param(False, marks=pytest.mark.slow), True])
def test_an_ideal_camera_is_the_delivered_one_with_unknowns_held(near_line: bool) -> None:
    pattern, ideal = reference_sheet(), STATES["ideal"]
    group, _ = pixels_of(np.zeros(LENS.image_size_px[::-1]), pattern, near_line=near_line)
    still = {"drawing": drawing_of(pattern), "near_line": near_line}
    general = full_state(ideal, TUNING.photometric)
    one, other = (rows_of(state, group, **still) for state in (ideal, general))
    same = [*range(9), *(9 + k for k in general.unknowns.ideal_camera_indices)]
    np.testing.assert_allclose(other.level, one.level, atol=1e-6)
    np.testing.assert_allclose(np.asarray(other.rows)[same], one.rows, rtol=1e-4, atol=1e-3)


def refined(
    picture: np.ndarray,
    start: tuple[float, ...],
    pattern: Pattern | None = None,
) -> ImageRefinement | None:
    sheet = reference_sheet() if pattern is None else pattern
    return refine_image(picture, sheet, LENS.lens, pose_of(start), PoseModel.AIMED)


START = (RIGHT[0] + 0.02, RIGHT[1] - 0.02, RIGHT[2] + 0.02, RIGHT[3] + 0.2, 0.0, 0.0)


def mahalanobis(result: ImageRefinement) -> float:
    """Squared Mahalanobis distance of the pose from the truth, by its own covariance."""
    truth = pose_of(RIGHT)
    turn = np.asarray(truth.rotation @ result.state.pose.rotation.T)
    vector = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    step = np.append(vector, float(truth.distance_mm / result.state.pose.distance_mm) - 1)
    return float(step @ result.information @ step)


@pytest.mark.slow
def test_errors_scatter_as_the_covariance_says() -> None:
    exact, trials = image_of(reference_sheet(), RIGHT, supersampling=32), 24
    squared = []
    for seed in range(trials):
        noisy = exact + np.random.default_rng(seed).normal(0.0, 2.0, exact.shape)
        result = refined(noisy, START)
        assert result is not None
        assert result.converged
        assert result.noise == pytest.approx(2.0, rel=0.04)
        assert result.noise_floor == pytest.approx(2.0, rel=0.06)
        squared.append(mahalanobis(result))
    # Chi-squares of four degrees of freedom: their mean within four deviations.
    assert abs(np.mean(squared) - 4) < 4 * np.sqrt(2 * 4 / trials)


def test_a_thumb_is_cut_and_counted() -> None:
    picture = image_of(reference_sheet(), RIGHT)
    picture += np.random.default_rng(3).normal(0.0, 2.0, picture.shape)
    clear = refined(picture, START)
    row, column = np.mgrid[: picture.shape[0], : picture.shape[1]]
    picture[np.hypot(row - 200, column - 330) < 45] = 120.0
    covered = refined(picture, START)
    assert clear is not None
    assert covered is not None
    assert clear.pixels_cut < 10
    assert covered.pixels_cut > 500
    assert mahalanobis(covered) < 25.0


def test_ink_that_spreads_is_measured() -> None:
    drawn = reference_sheet()
    printed = Pattern.cross_grid(
        rows=5,
        columns=5,
        pitch_mm=20.0,
        radius_mm=6.05,
        rings="none",
        line_width_mm=1.1,
        line_gap_mm=1.4,
        line_half_length_mm=(55.05, 55.05),
    )
    picture = image_of(printed, RIGHT)
    result = refined(picture + np.random.default_rng(0).normal(0, 1, picture.shape), START, drawn)
    assert result is not None
    assert float(result.state["spread_mm"]) == pytest.approx(0.05, abs=2e-3)
    assert mahalanobis(result) < 25.0


def test_a_blank_picture_is_not_fitted() -> None:
    assert refined(np.full(LENS.image_size_px[::-1], 128.0), START) is None
