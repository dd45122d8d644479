"""Fit of one image: robust steps, exclusion of outlier pixels, noise, least-squares steps.

The ideal camera is fitted first. For the full camera model, unknowns are freed one group after
another if the residuals need them. Robust steps and the choice of unknowns use a part of the
pixels, the last steps all of them.
"""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.descent import run_fit, weigh
from trinoc.calib.photometric.equations import ImageProblem, Prediction
from trinoc.calib.photometric.evidence import FIRST, OF_RESPONSE, find_evidence
from trinoc.calib.photometric.fit_state import ImageFitState
from trinoc.calib.photometric.gate import (
    gate_by_sigma,
    remove_correlated_neighbourhoods,
    robust_sigma,
)
from trinoc.calib.photometric.noise import noise_by_level
from trinoc.calib.photometric.pixel_selection import SUBSETS
from trinoc.calib.photometric.scene import PixelScene
from trinoc.calib.photometric.unknowns import (
    FULL,
    IDEAL,
    LOCAL_TERMS,
    ImageState,
    full_state,
)
from trinoc.calib.problem.solver import ArrowEquations, Solution
from trinoc.geometry.pose import Pose
from trinoc.numerics.block_arrow import BlockArrow
from trinoc.numerics.precision import as_numpy
from trinoc.numerics.programs import compile_once
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: initial noise as a share of the contrast.
_FIRST_NOISE = 0.01
# numerical: damping of robust steps, and of the first least-squares step.
_ROBUST_DAMPING, _FIRST_DAMPING = 1e-4, 1e-6
# numerical: a fit ends if the predicted decrease of chi-square is smaller. It is the square of the
# step in standard deviations: steps of .15 and .05. At 16 megapixels rounding in single precision
# leaves steps of .1, and the number of steps ends the fit.
_IDEAL_GAIN, _SMALL_GAIN = 0.15**2, 0.05**2
# numerical: largest numbers of steps, and of rounds that exclude outliers (`_GATES`).
_IDEAL_STEPS, _GATES, _FIRST_STEPS, _MORE_STEPS, _LAST_STEPS = 8, 3, 5, 5, 3
# numerical: rounds of freeing unknowns; a round ends early if no more are needed.
_ROUNDS = 2
# numerical: initial level of saturated paper, as a multiple of the saturation level.
_SATURATED_PAPER = 1.15
# numerical: largest share of ink and fewest pixels for the initial light of a block.
_PAPER_SHARE, _FEWEST_PIXELS = 0.03, 10


def fit_ideal_camera(
    scene: PixelScene, guess: ImageState
) -> tuple[ImageFitState, ImageFitState] | None:
    """Fit the ideal camera model to an image: linear response, Gaussian blur, quadratic light.

    Parameters
    ----------
    scene : pixels and constants of the fit.
    guess : initial values of the unknowns.

    Returns
    -------
    Result after the robust steps, and result after the least-squares steps. None if there are not
    more inlier pixels than unknowns.
    """
    size = scene.model.size
    all_unknowns = np.ones(size + IDEAL.size, dtype=bool)
    # The first step estimates constant light, the second a plane, the third all: spread of ink and
    # slopes of light would adapt to objects that cover the sheet.
    scales = scene.tuning.ideal_scales
    free = np.tile(all_unknowns, (len(scales), 1))
    spread, light = size + IDEAL.indices("spread_mm")[0], size + IDEAL.light[0]
    free[:2, spread] = free[0, light + 1 :] = free[1, light + 3 :] = False
    robust = _take_robust_steps(scene, guess, scales, free, stride=SUBSETS)
    residual = robust.level - scene.grey
    # Lower limit of the noise for noiseless images: the contrast over 1000.
    noise = max(robust_sigma(residual, 0.1 * guess.contrast), guess.contrast / 1000)
    sigma = np.full(len(residual), noise)
    inliers = gate_by_sigma(scene.pixels, residual, sigma, scene.tuning)
    if inliers.sum() <= len(all_unknowns):
        return None
    return robust, refit_ideal_camera(scene, robust.with_pixels(sigma=sigma, inliers=inliers))


def refit_ideal_camera(scene: PixelScene, fit_state: ImageFitState) -> ImageFitState:
    """Fit the ideal camera by least squares to the inlier pixels, weighted by their noise.

    Parameters
    ----------
    scene : pixels and constants of the fit.
    fit_state : previous fit of the ideal camera, with the noise and the inliers to use.
    """
    return _take_steps(scene, fit_state, _IDEAL_STEPS, _IDEAL_GAIN)


def fit_full_camera(
    scene: PixelScene, ideal: ImageState, circles: Pose
) -> tuple[PixelScene, ImageFitState] | None:
    """Fit the full camera model. Only unknowns that the image requires are estimated.

    Parameters
    ----------
    scene : pixels and constants of the fit, with the blocks of the sheet.
    ideal : values of the ideal camera after its robust steps.
    circles : pose from the circle centres. It is the initial pose if the paper is saturated.

    Returns
    -------
    The scene, in which each block has its own light if the image requires it, and the end of the
    fit. None if there are not more inlier pixels than unknowns.
    """
    part, size = scene.first(SUBSETS), scene.model.size
    first = [name for name in FIRST if scene.response_bend is None or name not in OF_RESPONSE]
    free = np.zeros(size + FULL.size, dtype=bool)
    free[:size] = free[_ideal_camera_columns(size)] = free[
        [size + k for k in FULL.indices(*first)]
    ] = True
    fit_state = _fit_robustly(part, _initial_full_state(part, ideal, circles), free)
    for _ in range(_ROUNDS):
        fit_state = _with_equations(part, _with_noise(part, fit_state))
        evidence = find_evidence(part, fit_state)
        if evidence.uneven_light:
            scene = scene._replace(has_local_light=True)
            part = part._replace(has_local_light=True)
            free = fit_state.free.copy()
            free[size + np.array(FULL.uneven_light_indices)] = True
            start = _initial_full_state(part, ideal, circles)
            fit_state = _fit_robustly(part, _with_local_light(part, start), free)
        elif evidence.free.any():
            fit_state = _take_steps(
                part, fit_state.with_free(fit_state.free | evidence.free), _MORE_STEPS
            )
        else:
            break
    fit_state = _fit_all_pixels(scene, fit_state)
    return (scene, fit_state) if fit_state.inliers.sum() > fit_state.free.sum() else None


def _fit_all_pixels(scene: PixelScene, fit_state: ImageFitState) -> ImageFitState:
    """Exclude outliers, estimate the noise and take the last steps of the fit, with all pixels."""
    fit_state = _exclude_outliers(
        scene, _evaluate(scene, fit_state.state, fit_state.free), rounds=1
    )
    fit_state = _take_steps(scene, fit_state, 1)
    residual, sigma = fit_state.residual(scene)
    inliers = remove_correlated_neighbourhoods(
        scene.pixels, residual / sigma, fit_state.inliers, scene.tuning
    )
    fit_state = fit_state.with_pixels(sigma=fit_state.sigma, inliers=inliers)
    for _ in range(_ROUNDS):
        fit_state = _with_equations(
            scene, _with_noise(scene, _take_steps(scene, fit_state, _LAST_STEPS))
        )
        evidence = find_evidence(scene, fit_state)
        if not evidence.free.any():
            break
        # After the last round they stay at their means; the covariance includes them.
        fit_state = fit_state.with_free(fit_state.free | evidence.free)
    return fit_state


def _ideal_camera_columns(pose_size: int) -> list[int]:
    """Indices of the ideal camera's unknowns in the vector of pose and values of the full model."""
    return [*range(pose_size), *(pose_size + int(k) for k in FULL.ideal_camera_indices)]


def _initial_full_state(scene: PixelScene, ideal: ImageState, circles: Pose) -> ImageState:
    """Initial values of the full model: those of the fitted ideal camera.

    If the paper is saturated, the initial values are a bright paper and the pose `circles`.
    """
    paper, ratio = float(ideal.light[0]), float(ideal["ratio"])
    state = full_state(ideal, scene.tuning)
    values = np.array(state.values)
    values[FULL.indices("bend")] = scene.response_bend or 0.0
    pose = state.pose
    if _is_saturated(scene, paper):
        # The ideal camera confuses saturation with the level of the paper: discard its fit.
        brighter = _SATURATED_PAPER * scene.top
        values[FULL.light] = 0.0
        values[FULL.light[0]] = brighter
        values[FULL.indices("ratio", "spread_mm")] = paper * (1 + ratio) / brighter - 1, 0.0
        pose = circles
    return ImageState(pose, values, state.levels, FULL)


def _is_saturated(scene: PixelScene, paper: float) -> bool:
    return bool(paper > 0.97 * scene.top)


def _with_local_light(scene: PixelScene, state: ImageState) -> ImageState:
    """Copy of a state in which each block of the sheet has its own light.

    Its initial value is the median level of the block's paper.
    """
    blocks = scene.blocks
    assert blocks is not None
    levels = np.zeros((LOCAL_TERMS, blocks.count))
    state = ImageState(state.pose, state.values, levels, FULL)
    light = scene.polynomial_light(state)
    level = _evaluate(scene, state, np.ones(scene.model.size + FULL.size, dtype=bool)).level
    share = (level / light - 1) / float(state["ratio"])
    for block in range(blocks.count):
        paper = (blocks.of_pixel == block) & (share < _PAPER_SHARE)
        if paper.sum() >= _FEWEST_PIXELS:
            levels[0, block] = np.median(scene.grey[paper] / light[paper]) - 1
    return state


def _fit_robustly(
    scene: PixelScene, state: ImageState, free: Bool[np.ndarray, "k"]
) -> ImageFitState:
    """First part of the fit: robust steps, exclusion of outlier pixels, first least-squares steps.

    free : mask of the estimated unknowns.
    """
    tuning = scene.tuning
    scales = tuning.scales
    if _is_saturated(scene, float(state.light[0])):
        scales = (*tuning.saturated_scales, *scales)
    ideal_only = np.zeros(len(free), dtype=bool)
    ideal_only[_ideal_camera_columns(scene.model.size)] = True
    # The first steps estimate only the unknowns of an ideal camera.
    stages = np.array([ideal_only if scale >= tuning.scales[0] else free for scale in scales])
    fit_state = _take_robust_steps(scene, state, scales, stages).with_free(free)
    return _take_steps(scene, _exclude_outliers(scene, fit_state), _FIRST_STEPS)


def _exclude_outliers(
    scene: PixelScene, fit_state: ImageFitState, rounds: int = _GATES
) -> ImageFitState:
    """Estimate the noise and exclude outlier pixels, `rounds` times.

    A least-squares step follows each round except the last.
    """
    fit_state = _with_noise(scene, fit_state, robust=True)
    for k in range(rounds):
        inliers = gate_by_sigma(scene.pixels, *fit_state.residual(scene), scene.tuning)
        fit_state = fit_state.with_pixels(sigma=fit_state.sigma, inliers=inliers)
        fit_state = _with_noise(scene, fit_state, robust=True)
        if k + 1 < rounds:
            fit_state = _take_steps(scene, fit_state, 1)
    return fit_state


def _with_noise(
    scene: PixelScene, fit_state: ImageFitState, *, robust: bool = False
) -> ImageFitState:
    """Copy of a fit whose noise is estimated from the residuals of the inliers.

    robust : True to use medians, while inliers may still contain outliers.
    """
    residual, scale = fit_state.residual(scene)[0], scene.noise_scale
    sigma = noise_by_level(
        fit_state.level,
        residual / scale,
        fit_state.is_clear(scene),
        fit_state.level,
        scene.tuning.fewest_pixels,
        robust=robust,
    )
    return fit_state.with_pixels(sigma=sigma * scale)


def _initial_pixels(
    scene: PixelScene, state: ImageState
) -> tuple[Bool[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Initial mask of the inliers (all pixels) and initial sigma of each pixel, grey levels."""
    return np.ones(len(scene.grey), dtype=bool), _FIRST_NOISE * state.contrast * scene.noise_scale


def _evaluate(scene: PixelScene, state: ImageState, free: Bool[np.ndarray, "k"]) -> ImageFitState:
    """Predict all pixels at the values of a state, without a step.

    All pixels are inliers and have their initial noise.

    free : mask of the estimated unknowns.
    """
    inliers, sigma = _initial_pixels(scene, state)
    problem = _problem(scene, state, sigma, inliers / sigma, free)
    start = _empty_equations(state, len(free))
    solution = _descend(scene, problem, state, start, _FIRST_DAMPING, most_steps=1)
    return _state_after(scene, solution, free, sigma, inliers)


def _empty_equations(state: ImageState, size: int) -> ArrowEquations:
    """Normal equations whose step is zero and always accepted.

    A descent that starts with them only evaluates the model at the initial state.

    size : number of unknowns of the pose and the image.
    """
    blocks = state.levels.shape[1]
    arrow = BlockArrow(
        np.zeros((size, size)),
        np.zeros((blocks, size, LOCAL_TERMS)),
        np.zeros((blocks, LOCAL_TERMS, LOCAL_TERMS)),
    )
    return ArrowEquations(
        np.asarray(np.inf), arrow, (np.zeros(size), np.zeros((blocks, LOCAL_TERMS)))
    )


def _take_robust_steps(
    scene: PixelScene,
    state: ImageState,
    scales: Sequence[float],
    free: Bool[np.ndarray, "s k"],
    stride: int = 1,
) -> ImageFitState:
    """Take one step at each scale of the robust loss, without a test that the cost decreases.

    Parameters
    ----------
    scene : pixels and constants of the fit.
    state : initial values of the unknowns.
    scales : scales of the loss, as fractions of the contrast between paper and ink.
    free : (s, k) mask of the estimated unknowns in each step.
    stride : the steps use the first 1/stride of the pixels. Only the final state is evaluated at
        all pixels.
    """
    inliers, sigma = _initial_pixels(scene, state)
    problem = _problem(scene, state, sigma, inliers / sigma, free[-1])
    strides = np.asarray(stride, dtype=np.int32), problem.stride
    start, damping = _empty_equations(state, free.shape[1]), _FIRST_DAMPING
    problem = dataclasses.replace(problem, stride=strides[0])
    solution = _descend(scene, problem, state, start, damping, most_steps=1)
    for k, scale in enumerate(scales):
        ceiling = np.asarray((scale / _FIRST_NOISE) ** 2)
        problem = dataclasses.replace(
            problem, loss=GemanMcClure(ceiling), free=free[k].astype(float)
        )
        start = weigh(problem, solution.state, solution.details.details)
        # With infinite cost, the step is accepted.
        start = start._replace(cost=np.asarray(np.inf))
        if k + 1 == len(scales):
            problem = dataclasses.replace(problem, stride=strides[1])
        solution = _descend(scene, problem, solution.state, start, _ROBUST_DAMPING, most_steps=1)
    fit = _state_after(scene, solution, free[-1], sigma, inliers)
    return dataclasses.replace(fit, equations=None)


def _take_steps(
    scene: PixelScene, fit_state: ImageFitState, most_steps: int, atol: float = _SMALL_GAIN
) -> ImageFitState:
    """Take least-squares steps with the current noise and inliers.

    atol : the steps end if the predicted decrease of chi-square is smaller.
    """
    fit_state = _with_equations(scene, fit_state)
    assert fit_state.equations is not None
    problem = _problem(
        scene, fit_state.state, fit_state.sigma, _weight(scene, fit_state), fit_state.free
    )
    solution = _descend(
        scene, problem, fit_state.state, fit_state.equations, _FIRST_DAMPING, most_steps, atol
    )
    if not solution.steps:
        return dataclasses.replace(fit_state, predicted_gain=float(solution.predicted_gain))
    return _state_after(scene, solution, fit_state.free, fit_state.sigma, fit_state.inliers)


def _with_equations(scene: PixelScene, fit_state: ImageFitState) -> ImageFitState:
    """Copy of a fit with normal equations for its current noise and inliers.

    Existing equations are not computed again.
    """
    if fit_state.equations is not None:
        return fit_state
    problem = _problem(
        scene, fit_state.state, fit_state.sigma, _weight(scene, fit_state), fit_state.free
    )
    equations = as_numpy(weigh(problem, fit_state.state, fit_state.prediction))
    return dataclasses.replace(fit_state, equations=equations)


def _weight(scene: PixelScene, fit_state: ImageFitState) -> Float[np.ndarray, "n"]:
    """Reciprocal standard deviation of each pixel's residual, (n,); 0 for outliers."""
    sigma = fit_state.sigma if fit_state.state.unknowns.is_ideal else fit_state.residual(scene)[1]
    return fit_state.inliers / sigma


def _problem(
    scene: PixelScene,
    state: ImageState,
    sigma: Float[np.ndarray, "n"],
    weight: Float[np.ndarray, "n"],
    free: Bool[np.ndarray, "k"],
) -> ImageProblem:
    """Least-squares problem of all pixels, with a loss that is not robust.

    sigma : (n,) standard deviation of the noise before saturation.
    weight : (n,) reciprocal standard deviation of the residual; 0 for outliers.
    free : (k,) mask of the estimated unknowns.
    """
    return ImageProblem(
        scene.image_data(state.unknowns, weight, sigma),
        GemanMcClure(np.asarray(np.inf)),
        free.astype(float),
        np.asarray(1, dtype=np.int32),
        scene.drawing,
        scene.model,
    )


def _descend(
    scene: PixelScene,
    problem: ImageProblem,
    state: ImageState,
    start: ArrowEquations,
    damping: float,
    most_steps: int,
    atol: float = 0.0,
) -> Solution[ImageState]:
    """Run the compiled descent; only one thread compiles it."""
    size, static = len(scene.groups[0].pixels.grey), (scene.drawing, scene.model)
    arguments = np.asarray(damping), np.asarray(most_steps), np.asarray(atol)
    with compile_once("run_fit", *static, size, state.unknowns, state.levels.shape):
        return run_fit(problem, state, start, *arguments)


def _state_after(
    scene: PixelScene,
    solution: Solution[ImageState],
    free: Bool[np.ndarray, "k"],
    sigma: Float[np.ndarray, "n"],
    inliers: Bool[np.ndarray, "n"],
) -> ImageFitState:
    """State of the fit that results from a descent.

    If the last step was rejected, the model is evaluated again at the final state.

    free, sigma, inliers : fields of the result, which the descent did not change.
    """
    state = jax.tree.map(np.asarray, solution.state)
    if not solution.has_details:
        fit = _evaluate(scene, state, free)
        return fit.with_pixels(sigma=sigma, inliers=inliers)
    prediction: Prediction = solution.details.details
    level = scene.join((prediction.near_circles.level, prediction.near_lines.level))
    equations = jax.tree.map(np.asarray, solution.details._replace(details=None))
    predicted_gain = float(solution.predicted_gain)
    level = level.astype(np.float64)
    return ImageFitState(state, free, prediction, level, sigma, inliers, equations, predicted_gain)
