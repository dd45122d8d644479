"""The fit of one picture: robust steps, gates for pixels, noise, steps of least squares.

Of an ideal camera, and of a camera as pictures show it, whose further unknowns are freed as the
residuals call for them. Robust steps and the choice of unknowns look at a part of the pixels, the
last steps at all of them.
"""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.descent import run_fit, weigh
from trinoc.calib.photometric.equations import PictureProblem, Prediction
from trinoc.calib.photometric.evidence import FIRST, OF_RESPONSE, find_evidence
from trinoc.calib.photometric.fit_state import PictureFitState
from trinoc.calib.photometric.gate import gate_by_sigma, robust_sigma, without_common
from trinoc.calib.photometric.noise import noise_by_level
from trinoc.calib.photometric.pixel_selection import PARTS
from trinoc.calib.photometric.scene import PixelScene
from trinoc.calib.photometric.unknowns import (
    DELIVERED,
    IDEAL,
    LOCAL_TERMS,
    PictureState,
    delivered_state,
)
from trinoc.calib.problem.solver import ArrowEquations, Solution
from trinoc.geometry.pose import Pose
from trinoc.numerics.block_arrow import BlockArrow
from trinoc.numerics.precision import as_numpy
from trinoc.numerics.programs import one_compiles
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: a start: noise before anything is known of it, as a share of the contrast.
_FIRST_NOISE = 0.01
# numerical: damping of steps that must not pay, and of the first of least squares.
_ROBUST_DAMPING, _FIRST_DAMPING = 1e-4, 1e-6
# numerical: a fit ends where the next step promises less of the chi-square: the square of a step in
# standard deviations. Pixels in single precision leave steps of .1 in a picture of 16 megapixels.
_IDEAL_GAIN, _SMALL_GAIN = 0.15**2, 0.05**2
# numerical: steps of iterations that converge.
_IDEAL_STEPS, _GATES, _FIRST_STEPS, _MORE_STEPS, _LAST_STEPS = 8, 3, 5, 5, 3
# numerical: of a loop that ends when the residuals call for no more unknowns.
_ROUNDS = 2
# numerical: a start: paper beyond saturation is so much brighter than it looks.
_BLINDED = 1.15
# numerical: a start of each block's light, from at least so many pixels with so little ink.
_PAPER_SHARE, _FEWEST_PIXELS = 0.03, 10


def fit_ideal_camera(
    scene: PixelScene, guess: PictureState
) -> tuple[PictureFitState, PictureFitState] | None:
    """Fits of an ideal camera after robust steps, and after steps of least squares; None where too
    few pixels stay."""
    size = scene.model.size
    everything = np.ones(size + IDEAL.size, dtype=bool)
    # Ink spread and the slopes of the light wait for the pose: they would bend to swallow what
    # covers the sheet.
    scales = scene.tuning.ideal_scales
    free = np.tile(everything, (len(scales), 1))
    spread, light = size + IDEAL.places("spread_mm")[0], size + IDEAL.light[0]
    free[:2, spread] = free[0, light + 1 :] = free[1, light + 3 :] = False
    robust = _take_robust_steps(scene, guess, scales, free, stride=PARTS)
    residual = robust.level - scene.grey
    # One grey level of an eight-bit picture stands for the noise of a picture without any.
    noise = max(robust_sigma(residual, 0.1 * guess.contrast), guess.contrast / 1000)
    sigma = np.full(len(residual), noise)
    kept = gate_by_sigma(scene.chosen, residual, sigma, scene.tuning)
    if kept.sum() <= len(everything):
        return None
    return robust, refit_ideal_camera(scene, robust.with_pixels(sigma=sigma, kept=kept))


def refit_ideal_camera(scene: PixelScene, point: PictureFitState) -> PictureFitState:
    """Fit of an ideal camera by least squares over the kept pixels, weighted by their noise."""
    return _take_steps(scene, point, _IDEAL_STEPS, _IDEAL_GAIN)


def fit_delivered_camera(
    scene: PixelScene, ideal: PictureState, circles: Pose
) -> tuple[PixelScene, PictureFitState] | None:
    """From the fit of an ideal camera, or the circles' pose, to that of all unknowns which the
    picture calls for, with the scene as it was lit; None where nothing is left to be fitted."""
    part, size = scene.first(PARTS), scene.model.size
    first = [name for name in FIRST if scene.bend is None or name not in OF_RESPONSE]
    free = np.zeros(size + DELIVERED.size, dtype=bool)
    free[:size] = free[_of_ideal_camera(size)] = free[
        [size + k for k in DELIVERED.places(*first)]
    ] = True
    point = _find_sheet(part, _start_delivered(part, ideal, circles), free)
    for _ in range(_ROUNDS):
        point = _look(part, _with_noise(part, point))
        evidence = find_evidence(part, point)
        if evidence.uneven_light:
            scene, part = scene._replace(local=True), part._replace(local=True)
            free = point.free.copy()
            free[size + np.array(DELIVERED.of_uneven_light)] = True
            start = _start_delivered(part, ideal, circles)
            point = _find_sheet(part, _light_blocks(part, start), free)
        elif evidence.free.any():
            point = _take_steps(part, point.with_free(point.free | evidence.free), _MORE_STEPS)
        else:
            break
    point = _finish(scene, point)
    return (scene, point) if point.kept.sum() > point.free.sum() else None


def _finish(scene: PixelScene, point: PictureFitState) -> PictureFitState:
    """All pixels: gate, noise, last steps."""
    point = _gate(scene, _start(scene, point.state, point.free), gates=1)
    point = _take_steps(scene, point, 1)
    residual, sigma = point.residual(scene)
    kept = without_common(scene.chosen, residual / sigma, point.kept, scene.tuning)
    point = point.with_pixels(sigma=point.sigma, kept=kept)
    for _ in range(_ROUNDS):
        point = _look(scene, _with_noise(scene, _take_steps(scene, point, _LAST_STEPS)))
        evidence = find_evidence(scene, point)
        if not evidence.free.any():
            break
        point = point.with_free(point.free | evidence.free)
    return point


def _of_ideal_camera(pose_size: int) -> list[int]:
    return [*range(pose_size), *(pose_size + int(k) for k in DELIVERED.of_ideal_camera)]


def _start_delivered(scene: PixelScene, ideal: PictureState, circles: Pose) -> PictureState:
    paper, ratio = float(ideal.light[0]), float(ideal["ratio"])
    state = delivered_state(ideal, scene.tuning)
    values = np.array(state.values)
    values[DELIVERED.places("bend")] = scene.bend or 0.0
    pose = state.pose
    if _is_blinded(scene, paper):
        # An ideal camera takes saturation for the paper's level: nothing it says is of use.
        brighter = _BLINDED * scene.top
        values[DELIVERED.light] = 0.0
        values[DELIVERED.light[0]] = brighter
        values[DELIVERED.places("ratio", "spread_mm")] = paper * (1 + ratio) / brighter - 1, 0.0
        pose = circles
    return PictureState(pose, values, state.levels, DELIVERED)


def _is_blinded(scene: PixelScene, paper: float) -> bool:
    return bool(paper > 0.97 * scene.top)


def _light_blocks(scene: PixelScene, state: PictureState) -> PictureState:
    """Each block's light from the median of its paper."""
    blocks = scene.blocks
    assert blocks is not None
    levels = np.zeros((LOCAL_TERMS, blocks.count))
    state = PictureState(state.pose, state.values, levels, DELIVERED)
    light = scene.polynomial_light(state)
    level = _start(scene, state, np.ones(scene.model.size + DELIVERED.size, dtype=bool)).level
    share = (level / light - 1) / float(state["ratio"])
    for block in range(blocks.count):
        paper = (blocks.of_pixel == block) & (share < _PAPER_SHARE)
        if paper.sum() >= _FEWEST_PIXELS:
            levels[0, block] = np.median(scene.grey[paper] / light[paper]) - 1
    return state


def _find_sheet(
    scene: PixelScene, state: PictureState, free: Bool[np.ndarray, "k"]
) -> PictureFitState:
    """Robust steps, the pixels that show the sheet, and first steps of least squares."""
    tuning = scene.tuning
    scales = tuning.scales
    if _is_blinded(scene, float(state.light[0])):
        scales = (*tuning.blinded_scales, *scales)
    alone = np.zeros(len(free), dtype=bool)
    alone[_of_ideal_camera(scene.model.size)] = True
    # At first the unknowns of an ideal camera find their way alone.
    stages = np.array([alone if scale >= tuning.scales[0] else free for scale in scales])
    point = _take_robust_steps(scene, state, scales, stages).with_free(free)
    return _take_steps(scene, _gate(scene, point), _FIRST_STEPS)


def _gate(scene: PixelScene, point: PictureFitState, gates: int = _GATES) -> PictureFitState:
    """Noise and pixels that show the sheet, a step between each look at them."""
    point = _with_noise(scene, point, robust=True)
    for k in range(gates):
        kept = gate_by_sigma(scene.chosen, *point.residual(scene), scene.tuning)
        point = point.with_pixels(sigma=point.sigma, kept=kept)
        point = _with_noise(scene, point, robust=True)
        if k + 1 < gates:
            point = _take_steps(scene, point, 1)
    return point


def _with_noise(
    scene: PixelScene, point: PictureFitState, *, robust: bool = False
) -> PictureFitState:
    """The same state with the noise that the residuals of its kept pixels have."""
    residual, scale = point.residual(scene)[0], scene.noise_scale
    sigma = noise_by_level(
        point.level,
        residual / scale,
        point.is_clear(scene),
        point.level,
        scene.tuning.fewest_pixels,
        robust=robust,
    )
    return point.with_pixels(sigma=sigma * scale)


def _before_noise_is_known(
    scene: PixelScene, state: PictureState
) -> tuple[Bool[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """All pixels, and a first noise of each."""
    return np.ones(len(scene.grey), dtype=bool), _FIRST_NOISE * state.contrast * scene.noise_scale


def _start(scene: PixelScene, state: PictureState, free: Bool[np.ndarray, "k"]) -> PictureFitState:
    """All pixels at a state, before anything is known of their noise."""
    kept, sigma = _before_noise_is_known(scene, state)
    problem = _problem(scene, state, sigma, kept / sigma, free)
    start = _no_equations(state, len(free))
    solution = _descend(scene, problem, state, start, _FIRST_DAMPING, most_steps=1)
    return _state_after(scene, solution, free, sigma, kept)


def _no_equations(state: PictureState, size: int) -> ArrowEquations:
    """Equations that have no step, of an infinite cost."""
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
    state: PictureState,
    scales: Sequence[float],
    free: Bool[np.ndarray, "s k"],
    stride: int = 1,
) -> PictureFitState:
    """One step at each scale, whether it pays or not, from before anything is known of the noise.

    stride : only the last step is followed by a look at more than the first of so many parts.
    """
    kept, sigma = _before_noise_is_known(scene, state)
    problem = _problem(scene, state, sigma, kept / sigma, free[-1])
    strides = np.asarray(stride, dtype=np.int32), problem.stride
    start, damping = _no_equations(state, free.shape[1]), _FIRST_DAMPING
    problem = dataclasses.replace(problem, stride=strides[0])
    solution = _descend(scene, problem, state, start, damping, most_steps=1)
    for k, scale in enumerate(scales):
        ceiling = np.asarray((scale / _FIRST_NOISE) ** 2)
        problem = dataclasses.replace(
            problem, loss=GemanMcClure(ceiling), free=free[k].astype(float)
        )
        start = weigh(problem, solution.state, solution.details.details)
        # It is accepted whatever it gains.
        start = start._replace(cost=np.asarray(np.inf))
        if k + 1 == len(scales):
            problem = dataclasses.replace(problem, stride=strides[1])
        solution = _descend(scene, problem, solution.state, start, _ROBUST_DAMPING, most_steps=1)
    fit = _state_after(scene, solution, free[-1], sigma, kept)
    return dataclasses.replace(fit, equations=None)


def _take_steps(
    scene: PixelScene, point: PictureFitState, most_steps: int, atol: float = _SMALL_GAIN
) -> PictureFitState:
    """Steps of least squares; noise and pixels stay as they are."""
    point = _look(scene, point)
    assert point.equations is not None
    problem = _problem(scene, point.state, point.sigma, _weight(scene, point), point.free)
    solution = _descend(
        scene, problem, point.state, point.equations, _FIRST_DAMPING, most_steps, atol
    )
    if not solution.steps:
        return dataclasses.replace(point, promised=float(solution.promised))
    return _state_after(scene, solution, point.free, point.sigma, point.kept)


def _look(scene: PixelScene, point: PictureFitState) -> PictureFitState:
    """The same state, with the equations that go with its noise and its pixels."""
    if point.equations is not None:
        return point
    problem = _problem(scene, point.state, point.sigma, _weight(scene, point), point.free)
    equations = as_numpy(weigh(problem, point.state, point.prediction))
    return dataclasses.replace(point, equations=equations)


def _weight(scene: PixelScene, point: PictureFitState) -> Float[np.ndarray, "n"]:
    """One over the standard deviation of each pixel's residual, 0 where it is cut."""
    sigma = point.sigma if point.state.unknowns.is_ideal else point.residual(scene)[1]
    return point.kept / sigma


def _problem(
    scene: PixelScene,
    state: PictureState,
    sigma: Float[np.ndarray, "n"],
    weight: Float[np.ndarray, "n"],
    free: Bool[np.ndarray, "k"],
) -> PictureProblem:
    """All pixels by plain least squares."""
    return PictureProblem(
        scene.picture(state.unknowns, weight, sigma),
        GemanMcClure(np.asarray(np.inf)),
        free.astype(float),
        np.asarray(1, dtype=np.int32),
        scene.drawing,
        scene.model,
    )


def _descend(
    scene: PixelScene,
    problem: PictureProblem,
    state: PictureState,
    start: ArrowEquations,
    damping: float,
    most_steps: int,
    atol: float = 0.0,
) -> Solution[PictureState]:
    size, static = len(scene.groups[0].pixels.grey), (scene.drawing, scene.model)
    arguments = np.asarray(damping), np.asarray(most_steps), np.asarray(atol)
    with one_compiles("run_fit", *static, size, state.unknowns, state.levels.shape):
        return run_fit(problem, state, start, *arguments)


def _state_after(
    scene: PixelScene,
    solution: Solution[PictureState],
    free: Bool[np.ndarray, "k"],
    sigma: Float[np.ndarray, "n"],
    kept: Bool[np.ndarray, "n"],
) -> PictureFitState:
    """The fit after steps; where the last of them was refused, after another look at the best."""
    state = jax.tree.map(np.asarray, solution.state)
    if not solution.has_details:
        fit = _start(scene, state, free)
        return fit.with_pixels(sigma=sigma, kept=kept)
    prediction: Prediction = solution.details.details
    level = scene.join((prediction.near_circles.level, prediction.near_lines.level))
    equations = jax.tree.map(np.asarray, solution.details._replace(details=None))
    promised = float(solution.promised)
    level = level.astype(np.float64)
    return PictureFitState(state, free, prediction, level, sigma, kept, equations, promised)
