"""The fit of a picture that an ideal camera's model does not explain.

Robust steps and the choice of unknowns look at a part of the pixels, the last steps at all of
them.
"""

import numpy as np

from trinoc.calib.photometric.camera_covariance import CameraFit, judged
from trinoc.calib.photometric.camera_evidence import FIRST, OF_RESPONSE, evidence_for_more
from trinoc.calib.photometric.camera_scene import CameraScene, predict_scene
from trinoc.calib.photometric.camera_steps import (
    Point,
    equations_at,
    reweighted,
    settle,
    stepped,
)
from trinoc.calib.photometric.clipped_noise import clipped
from trinoc.calib.photometric.gate import gate_by_sigma, without_common
from trinoc.calib.photometric.gauss_newton import ImageState
from trinoc.calib.photometric.local_light import LOCAL_TERMS, Blocks
from trinoc.calib.photometric.pixel_selection import PARTS, SelectedPixels
from trinoc.calib.photometric.unknowns import (
    LIGHT_TERMS,
    LOOK_NAMES,
    START,
    VEIL_TERMS,
    CameraState,
)
from trinoc.geometry import Pose
from trinoc.numerics import GemanMcClure

# Shares of the contrast at which a residual loses its influence (first with the simple unknowns).
_SCALES = (0.1, 0.07, 0.05, 0.05, 0.05)
_BLINDED_SCALES = (0.15, 0.15, 0.15, *_SCALES)
_DAMPING = 1e-4
_GATES, _FIRST_STEPS, _MORE_STEPS, _LAST_STEPS = 3, 5, 5, 3
_ROUNDS = 2
# Paper beyond saturation starts this much brighter than it looks.
_BLINDED = 1.15
_PAPER_SHARE, _FEWEST_PIXELS = 0.03, 10


def fit_camera(
    scene: CameraScene, fitted: ImageState, circles: Pose, blocks: Blocks
) -> CameraFit | None:
    """From the simple model's fit (or the circles' pose) to the extended model's.

    `blocks` of the pixels serve where light is too uneven for a polynomial. None where nothing
    is left to be fitted.
    """
    part = scene.first(PARTS)
    few = blocks.part(scene.first_pixels(PARTS))
    first = [name for name in FIRST if scene.bend is None or name not in OF_RESPONSE]
    active = [*scene.layout.simple, *scene.layout.look(*first)]
    point = _robust(part, _start(part, fitted, circles), active)
    point = settle(part, _gated(part, point, active), active, _FIRST_STEPS)
    for _ in range(_ROUNDS):
        point = reweighted(part, point)
        evidence = evidence_for_more(part, equations_at(part, point), active, few)
        if evidence.uneven_light:
            scene = scene._replace(blocks=blocks)
            part = scene.first(PARTS)
            active = [*active, *scene.layout.uneven_light]
            state = _locally_lit(part, _start(part, fitted, circles))
            point = _robust(part, state, active)
            point = settle(part, _gated(part, point, active), active, _FIRST_STEPS)
        elif evidence.free:
            active = [*active, *evidence.free]
            point = settle(part, point, active, _MORE_STEPS)
        else:
            break
    return _finished(scene, point.state, active, blocks)


def _finished(
    scene: CameraScene, state: CameraState, active: list[int], blocks: Blocks
) -> CameraFit | None:
    """All pixels: gate, noise, last steps, covariance."""
    point = _gated(scene, _point(scene, state), active, gates=1)
    point = settle(scene, point, active, 1)
    cut = clipped(point.prediction.level, point.sigma, scene.top)
    kept = without_common(_chosen(scene), (cut.mean - scene.grey) / cut.sigma, point.kept)
    point = point._replace(kept=kept)
    for _ in range(_ROUNDS):
        point = reweighted(scene, settle(scene, point, active, _LAST_STEPS))
        sums = equations_at(scene, point)
        evidence = evidence_for_more(scene, sums, active, blocks)
        if not evidence.free:
            break
        active = [*active, *evidence.free]
    if point.kept.sum() <= len(active):
        return None
    return judged(scene, point, sums, active)


def _start(scene: CameraScene, fitted: ImageState, circles: Pose) -> CameraState:
    appearance = fitted.appearance
    look = START.copy()
    for name in ("sigma_px", "spread_mm", "ratio"):
        look[LOOK_NAMES.index(name)] = float(getattr(appearance, name))
    look[LOOK_NAMES.index("bend")] = scene.bend or 0.0
    light = np.zeros(LIGHT_TERMS)
    light[: len(appearance.light)] = appearance.light
    pose = fitted.pose
    if _is_blinded(scene, light[0]):
        # The simple model took saturation for the paper's level: nothing it says is of use.
        ink = light[0] * (1 + float(appearance.ratio))
        light[:] = 0.0
        light[0] = _BLINDED * scene.top
        look[LOOK_NAMES.index("ratio")] = ink / light[0] - 1
        look[LOOK_NAMES.index("spread_mm")] = 0.0
        pose = circles
    return CameraState(pose, look, light, np.zeros(VEIL_TERMS), np.zeros((LOCAL_TERMS, 0)))


def _is_blinded(scene: CameraScene, paper: float) -> bool:
    return bool(paper > 0.97 * scene.top)


def _locally_lit(scene: CameraScene, state: CameraState) -> CameraState:
    """Each block's light from the median of its paper."""
    blocks = scene.blocks
    assert blocks is not None
    state = state._replace(levels=np.zeros((LOCAL_TERMS, blocks.count)))
    light = state.light @ scene.terms
    share = (predict_scene(scene, state).level / light - 1) / state.look_of("ratio")
    for block in range(blocks.count):
        paper = (blocks.of_pixel == block) & (share < _PAPER_SHARE)
        if paper.sum() >= _FEWEST_PIXELS:
            state.levels[0, block] = np.median(scene.grey[paper] / light[paper]) - 1
    return state


def _robust(scene: CameraScene, state: CameraState, active: list[int]) -> Point:
    """One step at each scale, without noise."""
    contrast = -state.look_of("ratio") * state.light[0]
    blinded = _is_blinded(scene, state.light[0])
    point = _point(scene, state)
    for scale in _BLINDED_SCALES if blinded else _SCALES:
        residual = clipped(point.prediction.level, point.sigma, scene.top).mean - scene.grey
        loss = GemanMcClure.from_scale(scale * contrast)
        weight = np.asarray(loss.weight(residual**2)) / point.sigma**2
        sums = equations_at(scene, point, weight)
        free = scene.layout.simple if scale > _SCALES[1] else active
        state, _ = stepped(scene, point.state, sums, free, _DAMPING)
        point = point._replace(state=state, prediction=predict_scene(scene, state))
    return point


def _gated(scene: CameraScene, point: Point, active: list[int], gates: int = _GATES) -> Point:
    """Noise and pixels that show the sheet, a step between each look at them."""
    chosen = _chosen(scene)
    point = reweighted(scene, point, robust=True)
    for k in range(gates):
        cut = clipped(point.prediction.level, point.sigma, scene.top)
        kept = gate_by_sigma(chosen, cut.mean - scene.grey, cut.sigma)
        point = reweighted(scene, point._replace(kept=kept), robust=True)
        if k + 1 < gates:
            point = settle(scene, point, active, 1)
    return point


def _chosen(scene: CameraScene) -> SelectedPixels:
    column, row = scene.uv_px.T
    return SelectedPixels(column, row, np.zeros(len(row), dtype=int))


def _point(scene: CameraScene, state: CameraState) -> Point:
    count = len(scene.grey)
    contrast = -state.look_of("ratio") * state.light[0]
    sigma = np.full(count, 0.01 * contrast) * scene.noise_scale
    return Point(state, predict_scene(scene, state), sigma, np.ones(count, dtype=bool))
