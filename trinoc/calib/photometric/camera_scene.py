"""The chosen pixels of a picture, and what a state of all unknowns predicts for them."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.photometric.camera_look import LOOK_TERMS, ROWS, predicted_rows
from trinoc.calib.photometric.correlated_noise import OnGrid
from trinoc.calib.photometric.gauss_newton import Group, sheet_from_camera, step_unit_mm
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.calib.photometric.local_light import Blocks, local_rows
from trinoc.calib.photometric.normal_equations import CHUNK
from trinoc.calib.photometric.pixel_selection import SMALLEST_CAPACITY
from trinoc.calib.photometric.unknowns import (
    LIGHT_DEGREE,
    VEIL_TERMS,
    CameraState,
    Layout,
    powers,
)
from trinoc.geometry import Pose, PoseModel
from trinoc.numerics import ArrayLike, one_compiles


class CameraScene(NamedTuple):
    """Everything about one picture that a fit holds fixed.

    Fields
    ------
    groups, counts : pixels near circles only and near lines, and how many of each take part.
    grey : (n,) observed, of both.
    uv_px : (n, 2) their places.
    terms : (15, n) of the light's polynomial.
    noise_scale : (n,) noise of a pixel over that of others of the same level.
    cross, drawing, model : of the sheet, and of the pose.
    white, top : grey level of a full signal, and where saturation cuts (infinity: nowhere).
    bend : of the response where it is known (0 linear, 1 sRGB), None where it is fitted.
    blocks : for local light, or None.
    """

    groups: tuple[Group, Group]
    counts: tuple[int, int]
    grey: Float[np.ndarray, "n"]
    uv_px: Int[np.ndarray, "n 2"]
    terms: Float[np.ndarray, "15 n"]
    noise_scale: Float[np.ndarray, "n"]
    cross: Cross
    drawing: Drawing
    model: PoseModel
    white: float
    top: float
    bend: float | None = None
    blocks: Blocks | None = None

    @property
    def layout(self) -> Layout:
        """Places of the unknowns."""
        return Layout(self.model.size)

    @property
    def prior(self) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Middle and weight of every unknown's prior."""
        return self.layout.prior(local=self.blocks is not None)

    @property
    def grid(self) -> OnGrid:
        """The pixels' places in the picture."""
        return OnGrid(self.uv_px[:, 0], self.uv_px[:, 1])

    def first_pixels(self, share: int) -> Int[np.ndarray, "m"]:
        """Indices of the first of `share` parts of each group's chunks."""
        full = [-(-count // (share * CHUNK)) * CHUNK for count in self.counts]
        few, many = np.minimum(full, self.counts)
        return np.concatenate([np.arange(few), self.counts[0] + np.arange(many)])

    def first(self, share: int) -> "CameraScene":
        """The first of `share` parts of the pixels, which cover the sheet as all do."""
        chosen = self.first_pixels(share)
        few = int(np.sum(chosen < self.counts[0]))
        return self._replace(
            counts=(few, len(chosen) - few),
            grey=self.grey[chosen],
            uv_px=self.uv_px[chosen],
            terms=self.terms[:, chosen],
            noise_scale=self.noise_scale[chosen],
            blocks=None if self.blocks is None else self.blocks.part(chosen),
        )


class CameraPrediction(NamedTuple):
    """What a state predicts.

    Fields
    ------
    level : (n,) grey levels before saturation.
    rows : (k, n) derivatives by (a step of the pose, look, light, veil).
    local : (6, n) by the levels of the pixel's block; none where light is not local.
    by_shift : (3, n) by the third column of the homography, which a shift of the picture changes.
    """

    level: Float[np.ndarray, "n"]
    rows: Float[np.ndarray, "k n"]
    local: Float[np.ndarray, "m n"]
    by_shift: Float[np.ndarray, "3 n"]


def light_terms(place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "15 n"]:
    """The light's polynomial at places in the picture."""
    linear = np.ascontiguousarray(place.T, dtype=np.float32)
    raised = [np.ones_like(linear)]
    for _ in range(LIGHT_DEGREE):
        raised.append(raised[-1] * linear)
    return np.stack([raised[i][0] * raised[j][1] for i, j in powers(LIGHT_DEGREE)])


def predict_scene(scene: CameraScene, state: CameraState) -> CameraPrediction:
    """Grey level and derivatives of every pixel."""
    homography, by_motion = (np.asarray(part) for part in _posed(state.pose, model=scene.model))
    light = state.light @ scene.terms
    veil = state.veil @ scene.terms[:VEIL_TERMS]
    factor, blocks = np.ones_like(light), scene.blocks
    if blocks is not None:
        factor, veil = blocks.light(state.levels), veil + blocks.veil(state.levels)
    single = np.float32
    rows = np.empty((ROWS, len(light)), single)
    start = 0
    for group, count, near_line in zip(scene.groups, scene.counts, (False, True), strict=True):
        part = slice(start, start + count)
        start += count
        fields = np.ones((2, len(group.pixels.grey)), single)
        fields[0, :count], fields[1, :count] = (light * factor)[part], veil[part]
        # The program is a large one: it is compiled for blocks of one size, whatever the picture's.
        for first in range(0, count, SMALLEST_CAPACITY):
            block = slice(first, first + SMALLEST_CAPACITY)
            left = min(count - first, SMALLEST_CAPACITY)
            pixels = jax.tree.map(lambda leaf, block=block: leaf[block], group.pixels)
            with one_compiles("predicted_rows", scene.drawing, near_line, len(pixels.grey)):
                predicted = predicted_rows(
                    homography.reshape(3, 3),
                    state.look,
                    *fields[:, block],
                    pixels,
                    np.asarray(-(-left // CHUNK), dtype=np.int32),
                    np.asarray(state.light[0]),
                    np.asarray(scene.white),
                    scene.cross,
                    drawing=scene.drawing,
                    near_line=near_line,
                )
            at = part.start + first
            rows[:, at : at + left] = np.asarray(predicted)[:, :left]
    # Pixels are predicted in single precision: what the unknowns lose there, all of them lose.
    exact = np.concatenate([homography, state.look])
    lost = (exact - exact.astype(single)).astype(single)
    by_light, by_veil = rows[-2], rows[-1]
    columns = np.empty((scene.layout.size, len(light)), single)
    motion, look, polynomial, veils = np.split(columns, scene.layout.ends)
    np.matmul(by_motion.T.astype(single), rows[1:10], out=motion)
    look[:] = rows[10 : 10 + LOOK_TERMS]
    np.multiply((by_light * factor).astype(single), scene.terms, out=polynomial)
    np.multiply(by_veil, scene.terms[:VEIL_TERMS], out=veils)
    local = np.empty((0, len(light)))
    if blocks is not None:
        local = local_rows(blocks, by_light * light, by_veil)
    level = rows[0] + (lost @ rows[1 : 10 + LOOK_TERMS])
    return CameraPrediction(level, columns, local, rows[3:10:3])


def moved_pose(pose: Pose, motion: Float[np.ndarray, "p"], model: PoseModel) -> Pose:
    """The pose after a step in units of its distance."""
    return jax.tree.map(np.asarray, _moved(pose, motion, model=model))


@partial(jax.jit, static_argnames="model")
def _moved(pose: Pose, motion: Float[ArrayLike, "p"], *, model: PoseModel) -> Pose:
    return pose.retract(motion, model, step_unit_mm(pose, model))


@partial(jax.jit, static_argnames="model")
def _posed(
    pose: Pose, *, model: PoseModel
) -> tuple[Float[ArrayLike, "9"], Float[ArrayLike, "9 p"]]:
    """The homography to the sheet and its derivative by a step of the pose."""

    def after(motion: Float[ArrayLike, "p"]) -> Float[ArrayLike, "9"]:
        return sheet_from_camera(pose.retract(motion, model, step_unit_mm(pose, model))).reshape(9)

    zero = jnp.zeros(model.size)
    return after(zero), jax.jacfwd(after)(zero)
