"""Laws of the picture's model: against integration, against differences, against pictures."""

import jax
import numpy as np
import pytest

from tests.calib.simulated import LENS, TABLE_1, camera_of, reference_sheet
from trinoc.calib import Pattern
from trinoc.calib.photometric import refine_image
from trinoc.calib.photometric.appearance import Appearance, Pixels, Prediction, predict
from trinoc.calib.photometric.gauss_newton import sheet_from_camera
from trinoc.calib.photometric.image_refinement import ImageRefinement
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.calib.photometric.pixel_selection import group_of, select_pixels
from trinoc.calib.result.degrees import pose_of_values
from trinoc.geometry import Pose, PoseModel
from trinoc.numerics import ArrayLike
from trinoc.synth import render_sheet

pytestmark = pytest.mark.usefixtures("large_programs")
RIGHT = (*TABLE_1["right"], 0.0, 0.0)
CROSS = Cross(np.array(0.5), np.array([55.0, 55.0]), np.array(1.5))
BLUR_PX = 0.7
LOOK = Appearance(
    np.array(np.hypot(BLUR_PX, np.sqrt(1 / 12))),
    np.array(0.0),
    np.array(25 / 230 - 1),
    np.array([230.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
)


def pose_of(values: tuple[float, ...]) -> Pose:
    return pose_of_values(np.array(values))


def image_of(pattern: Pattern, values: tuple[float, ...], supersampling: int = 16) -> np.ndarray:
    """A noiseless picture by the renderer, which knows nothing of the model."""
    return render_sheet(
        pattern,
        camera_of(values[:4], LENS, (values[4], values[5])),
        blur_px=BLUR_PX,
        supersampling=supersampling,
        dtype="float64",
    )


def model_residuals(pattern: Pattern, values: tuple[float, ...]) -> list[np.ndarray]:
    """Model minus picture at the true pose, near circles and near lines."""
    picture, pose = image_of(pattern, values), pose_of(values)
    choice = select_pixels(pose, LENS.lens, pattern, LENS.image_size_px, float(LOOK.sigma_px))
    drawing = Drawing(pattern.line_style, bool((pattern.inner_radius_mm > 0).any()))
    homography = np.asarray(sheet_from_camera(pose))
    residuals = []
    for chosen, near_line in ((choice.near_circles, False), (choice.near_lines, True)):
        pixels = group_of(chosen, picture, LENS.lens, pattern, 16384, np.float64).pixels

        def one(pixel: Pixels, near_line: bool = near_line) -> ArrayLike:
            return predict(homography, LOOK, pixel, CROSS, drawing, near_line).residual

        residuals.append(np.asarray(jax.jit(jax.vmap(one))(pixels))[: len(chosen.row)])
    return residuals


@pytest.mark.parametrize(
    ("rings", "style"),
    [
        ("none", "stop"),
        ("code", "through"),
        ("code", "white"),
        *(
            pytest.param(*both, marks=pytest.mark.slow)
            for both in (("none", "through"), ("none", "white"), ("code", "stop"))
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


@pytest.mark.parametrize("near_line", [False, True])
def test_derivatives_are_those_of_differences(near_line: bool) -> None:
    pattern, pose = reference_sheet(), pose_of(RIGHT)
    picture = np.zeros(LENS.image_size_px[::-1])
    choice = select_pixels(pose, LENS.lens, pattern, LENS.image_size_px, float(LOOK.sigma_px))
    chosen = choice.near_lines if near_line else choice.near_circles
    pixels = group_of(chosen, picture, LENS.lens, pattern, 16384, np.float64).pixels
    pixels = jax.tree.map(lambda leaf: leaf[: len(chosen.row)], pixels)
    drawing = Drawing("stop", False)

    @jax.jit
    def grey(homography: np.ndarray, look: np.ndarray) -> ArrayLike:
        def one(pixel: Pixels) -> ArrayLike:
            appearance = Appearance.from_vector(look)
            return predict(homography, appearance, pixel, CROSS, drawing, near_line).residual

        return jax.vmap(one)(pixels)

    homography, look = np.asarray(sheet_from_camera(pose)), np.asarray(LOOK.vector)

    @jax.jit
    @jax.vmap
    def predicted(pixel: Pixels) -> Prediction:
        return predict(homography, LOOK, pixel, CROSS, drawing, near_line)

    claimed = predicted(pixels)
    directions = [(np.eye(9)[k].reshape(3, 3), np.zeros(9)) for k in range(9)]
    directions += [(np.zeros((3, 3)), np.eye(9)[k]) for k in range(9)]
    columns = (*claimed.by_homography, *claimed.by_appearance)
    for (turn, change), column in zip(directions, columns, strict=True):
        step = 1e-5 * max(np.abs(homography[turn > 0]).max(initial=0), 1e-2)
        up = grey(homography + step * turn, look + step * change)
        down = grey(homography - step * turn, look - step * change)
        exact = (up - down) / (2 * step)
        # Directions and curvatures are held: a few percent of a row, and less over all.
        error = np.sqrt(np.mean((column - exact) ** 2) / np.mean(exact**2))
        assert error < 0.04


def refined(
    picture: np.ndarray,
    start: tuple[float, ...],
    pattern: Pattern | None = None,
) -> ImageRefinement | None:
    sheet = reference_sheet() if pattern is None else pattern
    return refine_image(picture, sheet, LENS.lens, pose_of(start), PoseModel.AIMED)


START = (RIGHT[0] + 0.02, RIGHT[1] - 0.02, RIGHT[2] + 0.02, RIGHT[3] + 0.2, 0.0, 0.0)


def mahalanobis(result: ImageRefinement) -> float:
    """Squared distance of the pose from the truth in its own covariance."""
    truth = pose_of(RIGHT)
    turn = np.asarray(truth.rotation @ result.pose.rotation.T)
    vector = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    step = np.append(vector, float(truth.distance_mm / result.pose.distance_mm) - 1)
    return float(step @ (result.information / result.noise**2) @ step)


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
    assert float(result.appearance.spread_mm) == pytest.approx(0.05, abs=2e-3)
    assert mahalanobis(result) < 25.0


def test_a_blank_picture_is_not_fitted() -> None:
    assert refined(np.full(LENS.image_size_px[::-1], 128.0), START) is None
