"""The fit of one picture: robust steps, gates for pixels, noise, steps of least squares.

Of an ideal camera, and of a camera as pictures show it, whose further unknowns are freed as the
residuals call for them. Robust steps and the choice of unknowns look at a part of the pixels, the
last steps at all of them.
"""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.evidence import FIRST, OF_RESPONSE, find_evidence
from trinoc.calib.photometric.gate import gate_by_sigma, robust_sigma, without_common
from trinoc.calib.photometric.noise import noise_by_level
from trinoc.calib.photometric.pixel_selection import PARTS
from trinoc.calib.photometric.scene import PixelScene, Point
from trinoc.calib.photometric.solver import Schedule, Stage, run_fit
from trinoc.calib.photometric.unknowns import (
    DELIVERED,
    IDEAL,
    LOCAL_TERMS,
    PictureState,
    delivered_state,
)
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.pose import Pose
from trinoc.numerics.programs import one_compiles
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: a start: noise before anything is known of it, as a share of the contrast.
_FIRST_NOISE = 0.01
_IDEAL_SCALES, _SCALES = TUNING.photometric.ideal_scales, TUNING.photometric.scales
_BLINDED_SCALES = (*TUNING.photometric.blinded_scales, *_SCALES)
_MOST_STAGES = len(_BLINDED_SCALES)
# numerical: a fit ends where the next step would move the pose by less of its standard deviations.
# Pixels in single precision leave steps of .1 in a picture of 16 megapixels.
_IDEAL_SIGMAS, _SHORT_SIGMAS = 0.15, 0.05
# numerical: steps of iterations that converge.
_IDEAL_STEPS, _GATES, _FIRST_STEPS, _MORE_STEPS, _LAST_STEPS = 8, 3, 5, 5, 3
# numerical: of a loop that ends when the residuals call for no more unknowns.
_ROUNDS = 2
# numerical: a start: paper beyond saturation is so much brighter than it looks.
_BLINDED = 1.15
# numerical: a start of each block's light, from at least so many pixels with so little ink.
_PAPER_SHARE, _FEWEST_PIXELS = 0.03, 10


def fit_ideal_camera(scene: PixelScene, guess: PictureState) -> tuple[Point, Point] | None:
    """Where robust steps end, and where the fit does; None where too few pixels stay."""
    size = scene.model.size
    everything = np.ones(size + IDEAL.size, dtype=bool)
    # Ink spread and the slopes of the light wait for the pose: they would bend to swallow what
    # covers the sheet.
    free = np.tile(everything, (len(_IDEAL_SCALES), 1))
    spread, light = size + IDEAL.places("spread_mm")[0], size + IDEAL.light[0]
    free[:2, spread] = free[0, light + 1 :] = free[1, light + 3 :] = False
    robust = _take_robust_steps(scene, guess, _IDEAL_SCALES, free, stride=PARTS)
    residual = robust.level - scene.grey
    # One grey level of an eight-bit picture stands for the noise of a picture without any.
    noise = max(robust_sigma(residual, 0.1 * guess.contrast), guess.contrast / 1000)
    sigma = np.full(len(residual), noise)
    kept = gate_by_sigma(scene.chosen, residual, sigma)
    if kept.sum() <= len(everything):
        return None
    return robust, refit_ideal_camera(scene, robust._replace(kept=kept, sigma=sigma))


def refit_ideal_camera(scene: PixelScene, point: Point) -> Point:
    """Least squares over the pixels that stayed, by their noise."""
    return _take_steps(scene, point, _IDEAL_STEPS, _IDEAL_SIGMAS)


def fit_delivered_camera(
    scene: PixelScene, ideal: PictureState, circles: Pose
) -> tuple[PixelScene, Point] | None:
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
            point = _take_steps(part, point._replace(free=point.free | evidence.free), _MORE_STEPS)
        else:
            break
    point = _finish(scene, point)
    return (scene, point) if point.kept.sum() > point.free.sum() else None


def _finish(scene: PixelScene, point: Point) -> Point:
    """All pixels: gate, noise, last steps."""
    point = _gate(scene, _start(scene, point.state, point.free), gates=1)
    point = _take_steps(scene, point, 1)
    residual, sigma = point.residual(scene)
    point = point._replace(kept=without_common(scene.chosen, residual / sigma, point.kept))
    for _ in range(_ROUNDS):
        point = _look(scene, _with_noise(scene, _take_steps(scene, point, _LAST_STEPS)))
        evidence = find_evidence(scene, point)
        if not evidence.free.any():
            break
        point = point._replace(free=point.free | evidence.free)
    return point


def _of_ideal_camera(pose_size: int) -> list[int]:
    return [*range(pose_size), *(pose_size + int(k) for k in DELIVERED.of_ideal_camera)]


def _start_delivered(scene: PixelScene, ideal: PictureState, circles: Pose) -> PictureState:
    paper, ratio = float(ideal.light[0]), float(ideal["ratio"])
    state = delivered_state(ideal)
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


def _find_sheet(scene: PixelScene, state: PictureState, free: Bool[np.ndarray, "k"]) -> Point:
    """Robust steps, the pixels that show the sheet, and first steps of least squares."""
    scales = _BLINDED_SCALES if _is_blinded(scene, float(state.light[0])) else _SCALES
    alone = np.zeros(len(free), dtype=bool)
    alone[_of_ideal_camera(scene.model.size)] = True
    # At first the unknowns of an ideal camera find their way alone.
    stages = np.array([alone if scale >= _SCALES[0] else free for scale in scales])
    point = _take_robust_steps(scene, state, scales, stages)._replace(free=free)
    return _take_steps(scene, _gate(scene, point), _FIRST_STEPS)


def _gate(scene: PixelScene, point: Point, gates: int = _GATES) -> Point:
    """Noise and pixels that show the sheet, a step between each look at them."""
    point = _with_noise(scene, point, robust=True)
    for k in range(gates):
        point = point._replace(kept=gate_by_sigma(scene.chosen, *point.residual(scene)))
        point = _with_noise(scene, point, robust=True)
        if k + 1 < gates:
            point = _take_steps(scene, point, 1)
    return point


def _with_noise(scene: PixelScene, point: Point, *, robust: bool = False) -> Point:
    """With the noise that the residuals of the pixels that stayed show."""
    residual, scale = point.residual(scene)[0], scene.noise_scale
    sigma = noise_by_level(
        point.level, residual / scale, point.clear(scene), point.level, robust=robust
    )
    return point._replace(sigma=sigma * scale)


def _start(scene: PixelScene, state: PictureState, free: Bool[np.ndarray, "k"]) -> Point:
    """All pixels, before anything is known of their noise."""
    kept = np.ones(len(scene.grey), dtype=bool)
    sigma = _FIRST_NOISE * state.contrast * scene.noise_scale
    return _fit(scene, state, free, kept, sigma, _schedule(free, 0, np.inf))


def _take_robust_steps(
    scene: PixelScene,
    state: PictureState,
    scales: Sequence[float],
    free: Bool[np.ndarray, "s k"],
    stride: int = 1,
) -> Point:
    """One step at each scale, from before anything is known of the noise."""
    kept = np.ones(len(scene.grey), dtype=bool)
    sigma = _FIRST_NOISE * state.contrast * scene.noise_scale
    schedule = _schedule(free[-1], 0, np.inf)
    stages = schedule.stages
    count = len(scales)
    ceiling = np.asarray(stages.loss.ceiling)
    ceiling[:count] = (np.array(scales) / _FIRST_NOISE) ** 2
    stages.free[:count], stages.stride[:count] = free, stride
    schedule = schedule._replace(robust_steps=np.asarray(count))
    return _fit(scene, state, free[-1], kept, sigma, schedule)


def _take_steps(
    scene: PixelScene, point: Point, most_steps: int, short: float = _SHORT_SIGMAS
) -> Point:
    """Steps of least squares; noise and pixels stay as they are."""
    schedule = _schedule(point.free, most_steps, short)
    return _fit(scene, point.state, point.free, point.kept, point.sigma, schedule)


def _look(scene: PixelScene, point: Point) -> Point:
    """The same state, with the equations that go with its noise and its pixels."""
    return _take_steps(scene, point, 0)


def _schedule(free: Bool[np.ndarray, "k"], most_steps: int, short: float) -> Schedule:
    """Without robust steps, in arrays of one shape for all."""
    count = _MOST_STAGES + 1
    stages = Stage(
        GemanMcClure(np.full(count, np.inf)),
        np.tile(free.astype(float), (count, 1)),
        np.ones(count, dtype=np.int32),
    )
    return Schedule(stages, np.asarray(0), np.asarray(most_steps), np.asarray(short))


def _fit(
    scene: PixelScene,
    state: PictureState,
    free: Bool[np.ndarray, "k"],
    kept: Bool[np.ndarray, "n"],
    sigma: Float[np.ndarray, "n"],
    schedule: Schedule,
) -> Point:
    picture = scene.picture(state.unknowns, kept, sigma)
    size, static = len(scene.groups[0].pixels.grey), (scene.drawing, scene.model)
    with one_compiles("run_fit", *static, size, state.unknowns, state.levels.shape):
        fit = run_fit(state, picture, schedule, drawing=scene.drawing, model=scene.model)
    fit = jax.tree.map(np.asarray, fit)
    near_circles, near_lines = fit.equations.pixels
    level = scene.join((near_circles.level, near_lines.level)).astype(np.float64)
    return Point(fit.state, free, fit.equations, float(fit.length), level, sigma, kept)
