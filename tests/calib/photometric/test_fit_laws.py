"""Laws of the fit to grey levels: equations and cost, priors, correlated noise."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.calib.photometric.pictures import RIGHT, image_of, state_at, with_appearance
from tests.calib.simulated import LENS, reference_sheet
from trinoc.calib.photometric import fit
from trinoc.calib.photometric.covariance import (
    elimination_matrix,
    pose_covariance,
    pose_information,
)
from trinoc.calib.photometric.encoding import AS_DELIVERED
from trinoc.calib.photometric.fit_state import ImageFitState
from trinoc.calib.photometric.gate import gate_by_sigma, remove_correlated_neighbourhoods
from trinoc.calib.photometric.noise import is_clear
from trinoc.calib.photometric.pixel_selection import SelectedPixels
from trinoc.calib.photometric.scene import PixelScene, blocks_of_pixels, build_scene
from trinoc.calib.photometric.unknowns import (
    LOCAL_TERMS,
    ImageState,
    full_state,
)
from trinoc.calib.problem.solver import ArrowEquations
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.block_arrow import BlockArrow
from trinoc.numerics.precision import ArrayLike

STATE = with_appearance(state_at(RIGHT), spread_mm=0.01)
FREE = np.ones(4 + STATE.unknowns.size, dtype=bool)
SIGMA = 2.0
RATIO = STATE.unknowns.indices("ratio")[0]


@pytest.fixture(scope="module")
def scene() -> PixelScene:
    picture = image_of(reference_sheet(), RIGHT)
    picture = picture + np.random.default_rng(0).normal(0.0, SIGMA, picture.shape)
    pose, model = state_at(RIGHT).pose, PoseModel.AIMED
    posed = build_scene(
        picture, reference_sheet(), LENS.lens, pose, model, None, AS_DELIVERED, TUNING.photometric
    )
    assert posed is not None
    return posed[0]


def with_prior(
    scene: PixelScene, middle: ArrayLike | float, width: ArrayLike | float
) -> PixelScene:
    """The scene with a prior of the ratio of ink to paper."""

    class WithPrior(PixelScene):
        def image_data(self, unknowns, weight, sigma):
            data = super().image_data(unknowns, weight, sigma)
            mean, precision = np.array(data.prior.mean), np.array(data.prior.weight)
            mean[RATIO], precision[RATIO] = middle, width**-2
            return data._replace(prior=data.prior._replace(mean=mean, weight=precision))

    return WithPrior(*scene)


def at(scene: PixelScene, state: ImageState, inliers: bool = True) -> ImageFitState:
    return looked_at(scene, fit._evaluate(scene, state, FREE), inliers=inliers)


def looked_at(scene: PixelScene, point: ImageFitState, inliers: bool = True) -> ImageFitState:
    everything, sigma = np.full(len(scene.grey), inliers), np.full(len(scene.grey), SIGMA)
    return fit._with_equations(scene, point.with_pixels(sigma=sigma, inliers=everything))


def cost(scene: PixelScene, point: ImageFitState) -> float:
    """Chi-square of the predicted levels plus that of the priors."""
    prior = scene.image_data(point.state.unknowns, point.sigma, point.sigma).prior
    priors = np.sum(prior.weight * (point.state.values - prior.mean) ** 2)
    return float(np.sum(((point.level - scene.grey) / SIGMA) ** 2) + priors)


def after(state: ImageState, step: np.ndarray) -> ImageState:
    moved = state.move(step, state.levels, PoseModel.AIMED)
    return ImageState(moved.pose, np.asarray(moved.values), state.levels, state.unknowns)


def test_the_gradient_is_half_the_cost_s_and_the_matrix_half_its_curvature(
    scene: PixelScene,
) -> None:
    scene = with_prior(scene, STATE["ratio"] + 0.02, 1e-3)
    here = at(scene, STATE)
    matrix, gradient, _ = here.normal_equations()
    assert here.equations is not None
    assert here.equations.cost == pytest.approx(cost(scene, here), rel=1e-6)
    spread = np.sqrt(np.diag(np.linalg.inv(matrix)))
    for k in range(len(FREE)):
        step = np.zeros(len(FREE))
        # So long that a percent of the row, which the model leaves out, hardly counts.
        step[k] = 3 * spread[k]
        up, down = (cost(scene, at(scene, after(STATE, sign * step))) for sign in (1, -1))
        slope = (up - down) / (2 * step[k])
        curvature = (up + down - 2 * cost(scene, here)) / step[k] ** 2
        predicted = 2 * gradient[k]
        assert predicted == pytest.approx(slope, rel=0.03, abs=0.3 / spread[k]), k
        assert 2 * matrix[k, k] == pytest.approx(curvature, rel=0.06), k


def test_priors_alone_are_a_quadratic(scene: PixelScene) -> None:
    scene = with_prior(scene, -0.5, 0.1)
    alone = at(scene, STATE, inliers=False)
    matrix, gradient, _ = alone.normal_equations()
    off = float(STATE["ratio"]) + 0.5
    expected = np.zeros(len(FREE))
    expected[4 + RATIO] = 1 / 0.1**2
    np.testing.assert_allclose(np.diag(matrix), expected)
    np.testing.assert_allclose(gradient, expected * off)
    assert alone.equations is not None
    np.testing.assert_allclose(alone.equations.cost, (off / 0.1) ** 2)


def test_steps_end_where_the_pixels_and_the_prior_balance(scene: PixelScene) -> None:
    """A step that raises the cost of the pixels is taken if the prior gains more."""
    free = fit._take_steps(scene, at(scene, STATE), 8)
    width = 0.2 / np.sqrt(free.normal_equations()[0][4 + RATIO, 4 + RATIO])
    constrained = with_prior(scene, float(free.state["ratio"]) + 0.05, width)
    pulled = fit._take_steps(constrained, at(constrained, free.state), 8, 1e-8)
    assert cost(constrained, pulled) < cost(constrained, at(constrained, free.state)) - 100
    # Pixels alone have become worse.
    assert cost(scene, pulled) > cost(scene, free) + 100
    matrix, gradient, _ = pulled.normal_equations()
    spread = np.sqrt(np.diag(np.linalg.inv(matrix)))
    # Without the prior it would be fifty.
    assert np.abs(gradient * spread).max() < 0.3


def test_covariance_is_that_of_draws_of_noise_that_neighbours_share(scene: PixelScene) -> None:
    exact = at(scene, STATE)
    random, kernel_px, shape = np.random.default_rng(1), 0.7, LENS.image_size_px[::-1]

    def drawn() -> np.ndarray:
        noise = gaussian_filter(random.normal(size=shape), kernel_px, mode="wrap")
        scale = SIGMA * 2 * kernel_px * np.sqrt(np.pi)
        return scale * noise[scene.pixels.image_index]

    rows = exact.rows(scene).astype(float)
    rows = np.concatenate([np.asarray(exact.prediction.by_motion).T @ rows[:9], rows[9:]]) / SIGMA
    solve = np.linalg.solve(rows @ rows.T, rows)[:4] / SIGMA
    errors = np.array([solve @ drawn() for _ in range(300)])
    truth = errors.T @ errors / len(errors)
    noisy = scene._replace(grey=exact.level - drawn())
    reported = pose_covariance(noisy, exact, correlated=True)
    white = pose_covariance(noisy, exact, correlated=False)
    ratio = np.diag(reported.matrix) / np.diag(truth)
    assert ratio == pytest.approx(np.ones(4), abs=0.35)
    assert (np.diag(white.matrix) < 0.7 * np.diag(truth)).all()
    assert reported.inflation > 1.5


def test_covariance_of_independent_noise_is_the_inverse_of_the_information(
    scene: PixelScene,
) -> None:
    exact = at(scene, STATE)
    noise = np.random.default_rng(2).normal(0.0, 2 * SIGMA, len(scene.grey))
    noisy = scene._replace(grey=exact.level - noise)
    covariance = np.linalg.inv(exact.normal_equations()[0])[:4, :4]
    for correlated in (False, True):
        reported = pose_covariance(noisy, exact, correlated=correlated)
        assert reported.chi_square == pytest.approx(4.0, rel=0.05)
        assert np.diag(reported.matrix) == pytest.approx(4 * np.diag(covariance), rel=0.2)


def test_derivatives_are_those_of_levels_that_saturation_cuts(scene: PixelScene) -> None:
    """The derivative by the paper's light is right even if half of the paper is saturated."""
    state = full_state(STATE, TUNING.photometric)
    cut = scene._replace(top=float(state.light[0]))
    light = state.unknowns.light[0]
    free = np.ones(4 + state.unknowns.size, dtype=bool)

    def evaluate_with_light(change: float) -> ImageFitState:
        values = np.array(state.values)
        values[light] += change
        there = ImageState(state.pose, values, state.levels, state.unknowns)
        return looked_at(cut, fit._evaluate(cut, there, free))

    up, down = (evaluate_with_light(sign * 0.5).residual(cut)[0] for sign in (1, -1))
    derivative = evaluate_with_light(0.0).rows(cut)[9 + light]
    assert derivative.min() < 0.7 < derivative.max()
    np.testing.assert_allclose(derivative, up - down, atol=0.01)


def test_the_information_of_a_pose_is_what_is_left_when_the_rest_is_free() -> None:
    rows, free = np.random.default_rng(1).normal(size=(20, 9)), np.ones(9, dtype=bool)
    free[7] = False
    matrix = rows.T @ rows
    information = pose_information(matrix, elimination_matrix(matrix, free, 4))
    covariance = np.linalg.inv(matrix[np.ix_(free, free)])[:4, :4]
    np.testing.assert_allclose(np.linalg.inv(information), covariance, rtol=1e-9)


def test_only_levels_far_below_saturation_are_clear() -> None:
    levels, sigma = np.array([254.0, 249.0, 235.0]), np.full(3, 2.0)
    assert is_clear(levels, sigma, 255.0, 2.0).tolist() == [False, True, True]
    assert is_clear(levels, sigma, 255.0, 4.0).tolist() == [False, False, True]


def all_pixels(side: int) -> SelectedPixels:
    row, column = (axis.ravel() for axis in np.mgrid[:side, :side])
    return SelectedPixels(column, row, np.zeros(side * side, dtype=np.int64))


def test_neighbours_whose_residuals_have_a_mean_go_and_white_noise_stays() -> None:
    pixels, noise = all_pixels(60), np.random.default_rng(2).normal(size=3600)
    everything = np.ones(3600, dtype=bool)
    assert (
        remove_correlated_neighbourhoods(pixels, noise, everything, TUNING.photometric).mean()
        > 0.99
    )
    shadow = (pixels.column < 20) & (pixels.row < 20)
    inliers = remove_correlated_neighbourhoods(
        pixels, noise + 3.0 * shadow, everything, TUNING.photometric
    )
    assert inliers[shadow].mean() < 0.3
    assert inliers[pixels.column > 40].all()


def test_crowds_of_outliers_go_with_their_whole_neighbourhood() -> None:
    pixels, residual = all_pixels(60), np.zeros(3600)
    thumb = (pixels.column < 20) & (pixels.row < 20)
    # Every second pixel under a thumb happens to have the right grey level.
    residual[thumb & ((pixels.column + pixels.row) % 2 == 0)] = 50.0
    inliers = gate_by_sigma(pixels, residual, np.ones(3600), TUNING.photometric)
    inside = (pixels.column < 15) & (pixels.row < 15)
    assert not inliers[inside].any()
    assert inliers[pixels.column > 40].all()


@pytest.mark.parametrize("level", range(LOCAL_TERMS))
def test_levels_of_a_block_have_their_slope_and_their_prior(scene: PixelScene, level: int) -> None:
    state, pose = full_state(STATE, TUNING.photometric), STATE.pose
    blocks = blocks_of_pixels(scene.pixels, pose, LENS.lens, reference_sheet())
    blocks = blocks._replace(count=blocks.count + 1)  # the last one has no pixels
    wider = tuple(2 * width for width in TUNING.photometric.local_widths)
    tuning = dataclasses.replace(TUNING.photometric, local_widths=wider)
    scene = scene._replace(blocks=blocks, has_local_light=True, tuning=tuning)
    free = np.ones(4 + state.unknowns.size, dtype=bool)
    sizes, block = 0.1 * np.asarray(wider), blocks.count // 2

    def with_level(change: float) -> ImageFitState:
        levels = np.zeros((LOCAL_TERMS, blocks.count))
        levels[level, block] = (1 + change) * sizes[level]
        there = ImageState(pose, np.asarray(state.values), levels, state.unknowns)
        return looked_at(scene, fit._evaluate(scene, there, free))

    up, here, down = (with_level(change).equations for change in (0.1, 0.0, -0.1))
    assert up is not None
    assert here is not None
    assert down is not None
    slope = float(up.cost - down.cost) / (0.2 * sizes[level])
    assert 2 * here.gradient[1][block, level] == pytest.approx(slope, rel=0.02)
    curvature = float(up.cost + down.cost - 2 * here.cost) / (0.1 * sizes[level]) ** 2
    inner = 2 * here.information.blocks[block, level, level]
    assert inner == pytest.approx(curvature, rel=0.1)
    expected = np.diag(np.array(wider) ** -2.0)
    np.testing.assert_allclose(here.information.blocks[-1], expected, rtol=1e-12)


def test_levels_are_eliminated_from_the_equations(scene: PixelScene) -> None:
    random, size, blocks = np.random.default_rng(4), len(FREE), 3
    rows = random.normal(size=(60, size + blocks * LOCAL_TERMS))
    for b in range(blocks):  # no pixel is of two blocks
        columns = slice(size + LOCAL_TERMS * b, size + LOCAL_TERMS * (b + 1))
        rows[np.arange(60) % blocks != b, columns] = 0.0
    normal, slope = rows.T @ rows, rows.T @ random.normal(size=60)
    level_columns = np.arange(blocks * LOCAL_TERMS).reshape(blocks, LOCAL_TERMS) + size
    arrow = BlockArrow(
        normal[:size, :size],
        np.stack([normal[:size, block_columns] for block_columns in level_columns]),
        np.stack([normal[np.ix_(block_columns, block_columns)] for block_columns in level_columns]),
    )
    equations = ArrowEquations(np.asarray(0.0), arrow, (slope[:size], slope[level_columns]))
    point = dataclasses.replace(at(scene, STATE), equations=equations)
    matrix, gradient, follow = point.normal_equations()
    step = np.linalg.solve(normal, slope)
    np.testing.assert_allclose(np.linalg.solve(matrix, gradient), step[:size], rtol=1e-6)
    alone = np.stack(
        [
            np.linalg.solve(part, slope[block_columns])
            for part, block_columns in zip(arrow.blocks, level_columns, strict=True)
        ]
    )
    np.testing.assert_allclose(alone + follow @ step[:size], step[level_columns], rtol=1e-6)
