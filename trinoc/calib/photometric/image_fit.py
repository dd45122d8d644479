"""From a pose that the circles gave to the one that explains the picture itself."""

import threading
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.model import SheetPoints
from trinoc.calib.photometric.appearance import LIGHT_TERMS, NUISANCE, Appearance
from trinoc.calib.photometric.camera_covariance import CameraFit
from trinoc.calib.photometric.camera_fit import fit_camera
from trinoc.calib.photometric.camera_patches import camera_rows
from trinoc.calib.photometric.camera_scene import CameraScene, light_terms
from trinoc.calib.photometric.clipped_noise import saturation_level, white_of
from trinoc.calib.photometric.encoding import AS_DELIVERED, Encoding
from trinoc.calib.photometric.found import found_in
from trinoc.calib.photometric.gate import gate_pixels
from trinoc.calib.photometric.gauss_newton import (
    Fit,
    Group,
    ImageState,
    Stage,
    StagedGaussNewton,
    Sums,
    run_fit,
)
from trinoc.calib.photometric.initial import initial_appearance
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.calib.photometric.line_pixels import places_of_pixels
from trinoc.calib.photometric.local_light import blocks_of_pixels
from trinoc.calib.photometric.mosaic import balanced_mosaic
from trinoc.calib.photometric.noise_by_level import noise_by_level
from trinoc.calib.photometric.patches import PixelRows, homography_of_pose, patch_points
from trinoc.calib.photometric.pixel_selection import (
    PARTS,
    PixelSelection,
    SelectedPixels,
    capacity_for,
    group_of,
    select_pixels,
)
from trinoc.calib.photometric.refutation import refuted_part
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens, Pose, PoseModel
from trinoc.numerics import GemanMcClure, noise_sigma

# Shares of the contrast at which a residual loses its influence while the fit finds its way.
_SCALES = (0.12, 0.07, 0.05)
# The first steps need not be exact: they look at a part of the pixels.
_STRIDES = (PARTS, PARTS, 1)
# The fit has converged when a step is this share of its own standard deviation, looked at after
# every second step.
_PLAIN_STEPS = 2
_CONVERGED_SIGMAS = 0.1
_LEAST_CONTRAST = 4.0
_SHIFT_ROUNDS = 3
# The median of flat parts sees no more noise than the residuals, a mosaic's colours apart.
_MOSAIC_NOISE = 1.5

# Of places of the sheet in mm, in px.
ShiftOfPlaces = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2"]]


class ImageRefinement(NamedTuple):
    """The fit of one picture, before anybody has judged it.

    Fields
    ------
    pose : where it ended.
    appearance : light, ink and blur of the picture.
    information : (p, p) of a step of the pose, lengths in units of its distance, for noise of one
        grey level, after the appearance has taken its share.
    noise : standard deviation of the residuals of the pixels that stayed, grey levels.
    noise_floor : the same of the picture's flat parts; `noise` itself of an extended model, whose
        noise depends on the grey level.
    pixels : number of pixels that stayed.
    pixels_cut : number of pixels near an edge that show something else than the sheet.
    converged : whether the last step was small against its own standard deviation.
    points : where the picture shows each circle and each piece of the crossed lines.
    found : what the picture shows of its camera and its light, in words; nothing where an ideal
        camera explains it.
    """

    pose: Pose
    appearance: Appearance
    information: Float[np.ndarray, "p p"]
    noise: float
    noise_floor: float
    pixels: int
    pixels_cut: int
    converged: bool
    points: SheetPoints
    found: tuple[str, ...] = ()


def refine_image(
    image: Float[np.ndarray, "h w"],
    pattern: Pattern,
    lens: AbstractLens,
    start: Pose,
    model: PoseModel,
    *,
    shift: ShiftOfPlaces | None = None,
    encoding: Encoding = AS_DELIVERED,
) -> ImageRefinement | None:
    """Fit the sheet's model to the pixels near its edges; None where none can be seen.

    An ideal camera's model comes first; where its residuals refute it, the extended one.

    shift : how far aside of where the lens and a flat sheet would have them, in px, the picture
        shows places of the sheet.
    encoding : how grey levels stand for light; with a response of sRGB the extended model is
        fitted at once.
    """
    noise_scale = np.ones_like(image)
    if encoding.bayer is not None:
        image, noise_scale = balanced_mosaic(image, encoding.bayer, start, lens, pattern)
    size = (image.shape[1], image.shape[0])
    appearance = initial_appearance(image, start, lens, pattern)
    contrast = float(-appearance.ratio * appearance.light[0])
    if not contrast > _LEAST_CONTRAST:
        return None
    choice = select_pixels(start, lens, pattern, size, float(appearance.sigma_px))
    chosen = (choice.near_circles, choice.near_lines)
    counts = [len(part.row) for part in chosen]
    capacity = capacity_for(max(counts))
    shifts = [_shifts(part, start, lens, shift) for part in chosen]
    circles, lines = (
        group_of(part, image, lens, pattern, capacity, np.float32, shift_px)
        for part, shift_px in zip(chosen, shifts, strict=True)
    )
    cross = Cross(
        np.asarray(0.5 * pattern.line_width_mm),
        np.array(pattern.line_half_length_mm, dtype=np.float64),
        np.asarray(float(pattern.line_gap_mm)),
    )
    drawing = Drawing(pattern.line_style, bool((pattern.inner_radius_mm > 0).any()))
    state = ImageState(start, appearance)

    fit = partial(_run, drawing=drawing, model=model)

    def residuals(fit: Fit) -> Float[np.ndarray, "n"]:
        both = zip(fit.sums.residuals, counts, strict=True)
        return np.concatenate([np.asarray(part)[:count] for part, count in both])

    first = fit(state, circles, lines, cross, _robust(contrast, model))
    everything = SelectedPixels(*(np.concatenate(pair) for pair in zip(*chosen, strict=True)))
    gate = gate_pixels(everything, residuals(first), contrast)
    kept = np.split(gate.kept, [counts[0]])
    groups = (_masked(circles, kept[0]), _masked(lines, kept[1]))
    last = fit(first.state, *groups, cross, _plain(gate.sigma, model))
    freedom = int(gate.kept.sum()) - model.size - NUISANCE
    if freedom <= 0:
        return None
    floor = noise_sigma(_cut_out(image, choice), flat=choice.flat)

    def shown(homography: np.ndarray, pixels: PixelRows) -> SheetPoints:
        points = patch_points(lens, pattern, homography, pixels)
        if shift is None:
            return points
        return points._replace(uv_px=points.uv_px + shift(points.place_mm))

    def simple(fit: Fit, groups: tuple[Group, Group]) -> ImageRefinement:
        """The fit of an ideal camera, its pixels weighed as the groups say."""
        state = jax.tree.map(np.asarray, fit.state)
        weights = np.concatenate(
            [group.pixels.weight[:n] for group, n in zip(groups, counts, strict=True)]
        )
        squares = weights[gate.kept] * residuals(fit)[gate.kept].astype(np.float64) ** 2
        noise = float(np.sqrt(np.sum(squares) / freedom))
        return ImageRefinement(
            state.pose,
            state.appearance,
            _marginal(np.asarray(fit.sums.information), model.size),
            noise,
            floor,
            int(gate.kept.sum()),
            int(np.sum(~gate.kept)),
            bool(fit.converged),
            shown(*_simple_rows(groups, chosen, fit.sums, noise)),
        )

    scene = CameraScene(
        (circles, lines),
        (counts[0], counts[1]),
        image[everything.row, everything.column].astype(np.float64),
        np.stack([everything.column, everything.row], axis=1),
        light_terms(_places(everything, size)),
        noise_scale[everything.row, everything.column].astype(np.float64),
        cross,
        drawing,
        model,
        white_of(image),
        saturation_level(image[everything.row, everything.column]),
        encoding.bend,
    )
    left = residuals(last)
    if floor > _MOSAIC_NOISE * float(np.sqrt(np.mean(left[gate.kept] ** 2))):
        # Flat parts are noisier than what the fit leaves over: neighbours differ by colour.
        return simple(last, groups)._replace(found=("a raw mosaic of colours",))
    look = jax.tree.map(np.asarray, last.state.appearance)
    is_ideal = encoding.bayer is None and not encoding.bend
    refuted = refuted_part(scene, look, left, gate.kept, floor) if is_ideal else "model"
    if refuted == "nothing":
        return simple(last, groups)
    if refuted == "noise":
        sigma = noise_by_level(scene.grey + left, left, gate.kept, scene.grey + left)
        share = np.split(np.mean(sigma[gate.kept] ** -2) ** -1 / sigma**2, [counts[0]])
        groups = (_masked(groups[0], share[0]), _masked(groups[1], share[1]))
        return simple(fit(last.state, *groups, cross, _plain(gate.sigma, model)), groups)
    blocks = blocks_of_pixels(scene.uv_px, start, lens, pattern)
    extended = fit_camera(scene, jax.tree.map(np.asarray, first.state), start, blocks)
    if extended is None or not np.isfinite(extended.covariance).all():
        return simple(last, groups)
    return _as_refinement(scene, extended, shown(*camera_rows(scene, everything, extended)))


def _as_refinement(scene: CameraScene, fit: CameraFit, points: SheetPoints) -> ImageRefinement:
    """The extended fit in the words of the simple one.

    The information is that of the covariance for the noise at the middle grey level.
    """
    look = fit.state.look_of
    appearance = Appearance(
        np.asarray(look("sigma_px")),
        np.asarray(look("spread_mm")),
        np.asarray(look("ratio")),
        fit.state.light[:LIGHT_TERMS],
    )
    return ImageRefinement(
        fit.state.pose,
        appearance,
        np.linalg.inv(fit.covariance) * fit.sigma**2,
        fit.sigma,
        fit.sigma,
        int(fit.kept.sum()),
        int(np.sum(~fit.kept)),
        True,
        points,
        found_in(scene, fit),
    )


def _simple_rows(
    groups: tuple[Group, Group],
    chosen: tuple[SelectedPixels, SelectedPixels],
    sums: Sums,
    noise: float,
) -> tuple[Float[np.ndarray, "3 3"], PixelRows]:
    """The pixels that stayed, at the end of the simple fit, and the homography there."""
    kept = [np.flatnonzero(group.pixels.weight) for group in groups]
    both = list(zip(groups, kept, sums.columns, sums.residuals, strict=True))
    columns = np.concatenate([np.asarray(part)[:, own] for _, own, part, _ in both], axis=1)
    rays = [jax.tree.map(lambda leaf, own=own: leaf[own], g.pixels.ray) for g, own, _, _ in both]
    near_lines = np.full(len(kept[1]), -1)
    rows = PixelRows(
        np.concatenate([chosen[0].circle[kept[0]], near_lines]),
        jax.tree.map(lambda *leaves: np.concatenate(leaves), *rays),
        columns[:3],
        columns[3:],
        np.concatenate([np.asarray(part)[own] for _, own, _, part in both]),
        np.concatenate([group.pixels.weight[own] for group, own, _, _ in both]) / noise**2,
        np.zeros(NUISANCE),
        np.zeros(NUISANCE),
    )
    # The pixels were looked at through what single precision leaves of the homography.
    return np.asarray(homography_of_pose(sums.pose)).astype(np.float32).astype(np.float64), rows


def _places(chosen: SelectedPixels, size: tuple[int, int]) -> Float[np.ndarray, "n 2"]:
    """(u, v) about the picture's middle in units of half its width."""
    uv_px = np.stack([chosen.column, chosen.row], axis=1).astype(np.float64)
    return (uv_px - 0.5 * (np.array(size) - 1)) / (0.5 * size[0])


def _shifts(
    chosen: SelectedPixels, pose: Pose, lens: AbstractLens, shift: ShiftOfPlaces | None
) -> Float[np.ndarray, "_n 2"] | None:
    if shift is None or not len(chosen.row):
        return None
    # What a pixel shows lies where the shift takes it from, not where it takes it to.
    shift_px = np.zeros((len(chosen.row), 2))
    for _ in range(_SHIFT_ROUNDS):
        column, row = chosen.column - shift_px[:, 0], chosen.row - shift_px[:, 1]
        shift_px = shift(places_of_pixels(column, row, pose, lens)[0])
    return shift_px


# Threads that meet an uncompiled program would each compile it; the first one does.
_COMPILING = threading.Lock()
_compiled: set[tuple[object, ...]] = set()


def _run(*arguments: Any, drawing: Drawing, model: PoseModel) -> Fit:
    key = (drawing, model, arguments[1].pixels.grey.shape)
    if key in _compiled:
        return run_fit(*arguments, drawing=drawing, model=model)
    with _COMPILING:
        fit = run_fit(*arguments, drawing=drawing, model=model)
        _compiled.add(key)
    return fit


def _robust(contrast: float, model: PoseModel) -> StagedGaussNewton:
    """One step at each scale.

    Ink spread and the slopes of the light wait for the pose: they would bend to swallow
    what covers the sheet.
    """
    spread, first_slope = model.size + 1, model.size + 4
    held = np.zeros((len(_SCALES), model.size + NUISANCE))
    held[:2, spread] = 1.0
    held[0, first_slope:] = 1.0
    held[1, first_slope + 2 :] = 1.0
    loss = GemanMcClure.from_scale(contrast * np.array(_SCALES))
    stages = Stage(loss, held, np.array(_STRIDES, dtype=np.int32))
    return StagedGaussNewton(
        stages=stages,
        round_steps=np.asarray(len(_SCALES)),
        model=model,
        atol=np.asarray(np.inf),
    )


def _plain(sigma: float, model: PoseModel) -> StagedGaussNewton:
    """Steps of least squares over all pixels, in arrays of the robust steps' shapes."""
    count = len(_SCALES)
    held = np.zeros((count, model.size + NUISANCE))
    loss = GemanMcClure.from_scale(np.full(count, np.inf))
    stages = Stage(loss, held, np.ones(count, dtype=np.int32))
    return StagedGaussNewton(
        stages=stages,
        round_steps=np.asarray(_PLAIN_STEPS),
        model=model,
        atol=np.asarray(_CONVERGED_SIGMAS * sigma),
    )


def _cut_out(image: Float[np.ndarray, "h w"], choice: PixelSelection) -> Float[np.ndarray, "k l"]:
    (row, column), (height, width) = choice.corner, choice.flat.shape
    return image[row : row + height, column : column + width]


def _masked(group: Group, kept: np.ndarray) -> Group:
    weight = np.array(group.pixels.weight)
    weight[: len(kept)] *= kept
    return group._replace(pixels=group.pixels._replace(weight=weight))


def _marginal(information: Float[np.ndarray, "k k"], pose_size: int) -> Float[np.ndarray, "p p"]:
    """Information of the pose alone: the Schur complement of the appearance."""
    pose, look = information[:pose_size], information[pose_size:]
    across = pose[:, pose_size:]
    inner = look[:, pose_size:]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    scaled = inner / (scale[:, None] * scale)
    if not np.isfinite(scaled).all():
        return np.full((pose_size, pose_size), np.nan)
    try:
        follow = np.linalg.solve(scaled, (across / scale).T)
    except np.linalg.LinAlgError:
        return np.full((pose_size, pose_size), np.nan)
    return pose[:, :pose_size] - (across / scale) @ follow
