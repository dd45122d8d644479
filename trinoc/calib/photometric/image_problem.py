"""The pixels of one picture that a fit looks at, chosen at its start."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric.appearance import Appearance
from trinoc.calib.photometric.camera_scene import CameraScene, light_terms
from trinoc.calib.photometric.clipped_noise import saturation_level, white_of
from trinoc.calib.photometric.encoding import Encoding
from trinoc.calib.photometric.gauss_newton import Group
from trinoc.calib.photometric.initial import initial_appearance
from trinoc.calib.photometric.ink_coverage import SQUARES, Cross, Drawing
from trinoc.calib.photometric.line_pixels import places_of_pixels
from trinoc.calib.photometric.mosaic import balanced_mosaic
from trinoc.calib.photometric.pixel_selection import (
    PixelSelection,
    SelectedPixels,
    capacity_for,
    group_of,
    select_pixels,
)
from trinoc.calib.targets import Pattern, SquareSheet
from trinoc.geometry import AbstractLens, Pose, PoseModel
from trinoc.image import noise_sigma

_LEAST_CONTRAST = 4.0
_SHIFT_ROUNDS = 3

# Of places of the sheet in mm, in px.
ShiftOfPlaces = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2"]]


class ImageProblem(NamedTuple):
    """One picture as a problem of least squares.

    Fields
    ------
    image : grey levels; a raw mosaic's with its colours balanced.
    noise_scale : noise of a pixel over that of others of the same level.
    start : pose that the pixels were chosen at.
    appearance : light, ink and blur there.
    model : what is free of the pose.
    chosen : pixels near circles only, and near lines.
    groups : the same, padded to one capacity.
    cross, drawing : of the sheet.
    """

    image: Float[np.ndarray, "h w"]
    noise_scale: Float[np.ndarray, "h w"]
    start: Pose
    appearance: Appearance
    model: PoseModel
    chosen: tuple[SelectedPixels, SelectedPixels]
    groups: tuple[Group, Group]
    cross: Cross
    drawing: Drawing

    @property
    def contrast(self) -> float:
        """Grey levels between paper and ink."""
        return float(-self.appearance.ratio * self.appearance.light[0])

    @property
    def counts(self) -> tuple[int, int]:
        """Pixels of each group, without padding."""
        return len(self.chosen[0].row), len(self.chosen[1].row)

    @property
    def everything(self) -> SelectedPixels:
        """The pixels of both groups."""
        return jax.tree.map(lambda *pair: np.concatenate(pair), *self.chosen)


def image_problem(
    image: Float[np.ndarray, "h w"],
    pattern: Pattern | SquareSheet,
    lens: AbstractLens,
    start: Pose,
    model: PoseModel,
    shift: ShiftOfPlaces | None,
    encoding: Encoding,
) -> tuple[ImageProblem, float] | None:
    """The problem, and the noise of the picture's flat parts; None where no ink shows."""
    noise_scale = np.broadcast_to(np.float32(1.0), image.shape)
    if encoding.bayer is not None:
        assert isinstance(pattern, Pattern)
        image, noise_scale = balanced_mosaic(image, encoding.bayer, start, lens, pattern)
    appearance = initial_appearance(image, start, lens, pattern)
    if not -appearance.ratio * appearance.light[0] > _LEAST_CONTRAST:
        return None
    size = (image.shape[1], image.shape[0])
    choice = select_pixels(start, lens, pattern, size, float(appearance.sigma_px))
    chosen = (choice.near_circles, choice.near_lines)
    capacity = capacity_for(max(len(part.row) for part in chosen))
    near_circles, near_lines = (
        group_of(
            part, image, lens, pattern, capacity, np.float32, _shifts(part, start, lens, shift)
        )
        for part in chosen
    )
    problem = ImageProblem(
        image,
        noise_scale,
        start,
        appearance,
        model,
        chosen,
        (near_circles, near_lines),
        _cross(pattern),
        _drawing(pattern),
    )
    return problem, noise_sigma(_cut_out(image, choice), flat=choice.flat)


def camera_scene(problem: ImageProblem, encoding: Encoding) -> CameraScene:
    """The same pixels, as the extended model sees them."""
    everything = problem.everything
    at = everything.row, everything.column
    uv_px = np.stack([everything.column, everything.row], axis=1)
    grey = problem.image[at]
    return CameraScene(
        problem.groups,
        problem.counts,
        grey.astype(np.float64),
        uv_px,
        light_terms(_from_middle(uv_px, problem.image.shape)),
        problem.noise_scale[at].astype(np.float64),
        problem.cross,
        problem.drawing,
        problem.model,
        white_of(problem.image),
        saturation_level(grey),
        encoding.bend,
    )


def _drawing(pattern: Pattern | SquareSheet) -> Drawing:
    if isinstance(pattern, SquareSheet):
        return Drawing(SQUARES, False)
    return Drawing(pattern.line_style, bool((pattern.inner_radius_mm > 0).any()))


def _cross(pattern: Pattern | SquareSheet) -> Cross:
    if isinstance(pattern, SquareSheet):
        return Cross(np.zeros(()), np.zeros(2), np.zeros(()))
    return Cross(
        np.asarray(0.5 * pattern.line_width_mm),
        np.array(pattern.line_half_length_mm, dtype=np.float64),
        np.asarray(float(pattern.line_gap_mm)),
    )


def _from_middle(uv_px: np.ndarray, shape: tuple[int, ...]) -> Float[np.ndarray, "n 2"]:
    """(u, v) about the picture's middle in units of half its width."""
    height, width = shape
    return (uv_px - 0.5 * (np.array([width, height]) - 1)) / (0.5 * width)


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


def _cut_out(image: Float[np.ndarray, "h w"], choice: PixelSelection) -> Float[np.ndarray, "k l"]:
    (row, column), (height, width) = choice.corner, choice.flat.shape
    return image[row : row + height, column : column + width]
