"""Constants of the fit of one image: selected pixels, sheet, saturation, and initial state."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.photometric.encoding import Encoding, balance_mosaic
from trinoc.calib.photometric.equations import (
    CHUNK,
    Group,
    ImageData,
    LocalPixels,
    light_terms,
)
from trinoc.calib.photometric.ink import SQUARES, Cross, InkDrawing
from trinoc.calib.photometric.noise import (
    PixelGrid,
    Saturation,
    saturation_level,
    white_level,
)
from trinoc.calib.photometric.pixel_selection import (
    PixelSelection,
    SelectedPixels,
    pad_group,
    padded_capacities,
    select_pixels,
)
from trinoc.calib.photometric.sheet_geometry import (
    circle_points_mm,
    project_to_image,
    sheet_points_of_pixels,
)
from trinoc.calib.photometric.square_pixels import list_control_points
from trinoc.calib.photometric.unknowns import ImageState, Unknowns, ideal_state
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.image.noise import noise_sigma
from trinoc.numerics.joins import point_tree
from trinoc.numerics.precision import ArrayLike

# numerical: iterations; the displacement has converged after these.
_SHIFT_ROUNDS = 3
# numerical: additional variance of an edge in a central difference over two pixels, px^2.
_DIFFERENCE_VARIANCE = 1 / 3
_LEAST_SIGMA_PX, _LARGEST_SIGMA_PX = 0.4, 8.0  # numerical: limits of the initial blur

# Displacement in the image, px, as a function of the point of the sheet, mm.
ImageShift = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2"]]


class Blocks(NamedTuple):
    """Blocks of the sheet, one around each circle.

    Fields
    ------
    of_pixel : (n,) index of the block of each pixel: the nearest circle.
    basis : (n, 3) values (1, x, y) of each pixel relative to the block's centre, in half pitches.
    count : number of blocks.
    """

    of_pixel: Int[np.ndarray, "n"]
    basis: Float[np.ndarray, "n 3"]
    count: int

    def part(self, chosen: Int[np.ndarray, "m"]) -> "Blocks":
        """Select pixels by an index."""
        return Blocks(self.of_pixel[chosen], self.basis[chosen], self.count)


class PixelScene(NamedTuple):
    """Constants of the fit of one image.

    Fields
    ------
    groups, counts : padded pixels near circles only and near lines, and their numbers.
    chosen : the n pixels of both groups.
    grey : (n,) observed grey levels.
    noise_scale : (n,) relative noise of pixels of equal level, for scaled mosaics.
    noise_floor : standard deviation of the noise in flat parts of the image.
    cross, drawing : crossed lines and properties of the sheet.
    model : parameters of the pose that are estimated.
    white, top : grey level of a full signal, and saturation level (infinity without saturation).
    tuning : constants of the fit.
    bend : curvature of a known response (0 linear, 1 sRGB); None if it is estimated.
    blocks : blocks of the n pixels; None until a fit needs them.
    has_local_light : True if each block has its own light.
    """

    groups: tuple[Group, Group]
    counts: tuple[int, int]
    chosen: SelectedPixels
    grey: Float[np.ndarray, "n"]
    noise_scale: Float[np.ndarray, "n"]
    noise_floor: float
    cross: Cross
    drawing: InkDrawing
    model: PoseModel
    white: float
    top: float
    tuning: PhotometricTuning
    bend: float | None = None
    blocks: Blocks | None = None
    has_local_light: bool = False

    @property
    def grid(self) -> PixelGrid:
        """Lookup of neighbouring pixels."""
        return PixelGrid(self.chosen.column, self.chosen.row, self.tuning.shared_reach_px)

    @property
    def saturation(self) -> Saturation:
        """Saturation level, with the noise assumed for clipped pixels."""
        return Saturation(np.asarray(self.top), np.asarray(self.tuning.cut_off_levels))

    def first(self, share: int) -> "PixelScene":
        """Scene with the first 1/`share` of the pixels, which covers the sheet evenly."""
        chunks = [-(-count // (share * CHUNK)) for count in self.counts]
        circles, lines = (min(n * CHUNK, c) for n, c in zip(chunks, self.counts, strict=True))
        part = np.concatenate([np.arange(circles), self.counts[0] + np.arange(lines)])
        return self._replace(
            groups=tuple(
                group._replace(chunks=np.asarray(count, dtype=np.int32))
                for group, count in zip(self.groups, chunks, strict=True)
            ),
            counts=(circles, lines),
            chosen=self.chosen.part(part),
            grey=self.grey[part],
            noise_scale=self.noise_scale[part],
            blocks=None if self.blocks is None else self.blocks.part(part),
        )

    def join_pixels(self, parts: Sequence[ArrayLike]) -> np.ndarray:
        """Join values of both groups, with pixels along the first axis; removes padding."""
        groups = zip(parts, self.counts, strict=True)
        return np.concatenate([np.asarray(part)[:count] for part, count in groups])

    def join(self, parts: tuple[ArrayLike, ArrayLike]) -> np.ndarray:
        """Join values of both groups, with chunks along the first axis; removes padding."""
        flat = [
            np.moveaxis(np.asarray(part), 0, -2).reshape(*part.shape[1:-1], -1) for part in parts
        ]
        groups = zip(flat, self.counts, strict=True)
        return np.concatenate([part[..., :count] for part, count in groups], axis=-1)

    def image_data(
        self,
        unknowns: Unknowns,
        weight: Float[np.ndarray, "n"],
        sigma: Float[np.ndarray, "n"],
    ) -> ImageData:
        """Data of the image for the compiled programs, with weights and noise of the pixels."""
        groups = []
        for k, group in enumerate(self.groups):
            part = slice(0, self.counts[0]) if k == 0 else slice(self.counts[0], None)
            local = None
            if self.has_local_light and self.blocks is not None:
                block = _pad_values(self.blocks.of_pixel[part], 0, group).astype(np.int32)
                local = LocalPixels(block, _pad_values(self.blocks.basis[part], 0.0, group))
            pixels = group.pixels._replace(
                weight=_pad_values(weight[part], 0.0, group),
                sigma=_pad_values(sigma[part], 1.0, group),
            )
            groups.append(Group(pixels, group.chunks, local))
        prior = unknowns.prior(self.tuning, local=self.has_local_light)
        white = np.asarray(self.white)
        return ImageData(groups[0], groups[1], self.cross, white, self.saturation, prior)

    def polynomial_light(self, state: ImageState) -> Float[np.ndarray, "n"]:
        """Grey level of the paper at each pixel, without local light."""
        position = self.join_pixels([group.pixels.position for group in self.groups]).T
        return np.asarray(state.light) @ np.asarray(light_terms(position, len(state.light)))


def _pad_values(values: np.ndarray, rest: float, group: Group) -> np.ndarray:
    """Pad values to the length of a group with `rest`."""
    grey = group.pixels.grey
    array = np.full((len(grey), *values.shape[1:]), rest, grey.dtype)
    array[: len(values)] = values
    return array


def build_scene(
    image: Float[np.ndarray, "h w"],
    pattern: Pattern | SquareSheet,
    lens: AbstractLens,
    start: Pose,
    model: PoseModel,
    shift: ImageShift | None,
    encoding: Encoding,
    tuning: PhotometricTuning,
) -> tuple[PixelScene, ImageState] | None:
    """Select pixels and make the initial state of an ideal camera.

    For the parameters see `trinoc.calib.photometric.image_fit.refine_image`.

    Returns
    -------
    Scene and initial state; None if paper and ink have no contrast.
    """
    noise_scale = np.broadcast_to(np.float32(1.0), image.shape)
    if encoding.bayer is not None:
        assert isinstance(pattern, Pattern)
        image, noise_scale = balance_mosaic(
            image, encoding.bayer, start, lens, pattern, tuning.fewest_pixels
        )
    state = first_guess(image, start, lens, pattern)
    if not state.contrast > tuning.least_contrast:
        return None
    size = (image.shape[1], image.shape[0])
    choice = select_pixels(start, lens, pattern, size, _reach_px(state, tuning))
    parts = (choice.near_circles, choice.near_lines)
    groups = [
        pad_group(
            part, image, lens, pattern, capacity, np.float32, _shifts(part, start, lens, shift)
        )
        for part, capacity in zip(parts, padded_capacities(*parts), strict=True)
    ]
    # All programs use them: transfer them to the device once.
    groups = jax.device_put(groups)
    chosen = jax.tree.map(lambda *pair: np.concatenate(pair), *parts)
    grey = image[chosen.image_index]
    scene = PixelScene(
        (groups[0], groups[1]),
        (len(parts[0].row), len(parts[1].row)),
        chosen,
        grey.astype(np.float64),
        noise_scale[chosen.image_index].astype(np.float64),
        noise_sigma(_cut_out(image, choice), flat=choice.flat),
        _cross(pattern),
        _drawing(pattern),
        model,
        white_level(image),
        saturation_level(grey, tuning.piled_share),
        tuning,
        encoding.bend,
    )
    return scene, state


def _reach_px(state: ImageState, tuning: PhotometricTuning) -> float:
    """Largest distance of a selected pixel from an edge."""
    return tuning.reach_sigmas * float(state["sigma_px"]) + tuning.reach_px


def first_guess(
    image: Float[np.ndarray, "h w"], pose: Pose, lens: AbstractLens, pattern: Pattern | SquareSheet
) -> ImageState:
    """Initial state of an ideal camera, from medians over all circles or squares.

    Levels of paper and ink are read beside and inside them, the blur follows from the gradient at
    their edges.
    """
    samples_mm = _sample_points(pattern)
    uv_px = np.asarray(project_to_image(pose, lens, np.concatenate(samples_mm)))
    limit = np.array(image.shape[::-1]) - 1
    ends = np.cumsum([len(part) for part in samples_mm])[:-1]
    pixels = np.split(np.round(uv_px).astype(int), ends)
    ink, edge, paper = (p[((p >= 1) & (p < limit)).all(axis=1)] for p in pixels)
    u, v = edge[:, 0], edge[:, 1]
    slope = 0.5 * np.hypot(image[v, u + 1] - image[v, u - 1], image[v + 1, u] - image[v - 1, u])
    paper_grey = float(np.median(image[paper[:, 1], paper[:, 0]]))
    ink_grey = float(np.median(image[ink[:, 1], ink[:, 0]]))
    steepest = max(float(np.median(slope)), 1e-6)
    variance = ((paper_grey - ink_grey) / (steepest * np.sqrt(2 * np.pi))) ** 2
    sigma = np.sqrt(max(variance - _DIFFERENCE_VARIANCE, _LEAST_SIGMA_PX**2))
    ratio = ink_grey / max(paper_grey, 1e-6) - 1
    return ideal_state(pose, min(sigma, _LARGEST_SIGMA_PX), ratio, np.array([paper_grey]))


def _sample_points(pattern: Pattern | SquareSheet) -> tuple[Float[np.ndarray, "_n 2"], ...]:
    """Points of the sheet in ink, on edges, and on paper."""
    if isinstance(pattern, SquareSheet):
        return list_control_points(pattern)
    outer, inner = pattern.radius_mm, pattern.inner_radius_mm
    radii = (0.5 * (outer + inner), outer, outer + 0.3 * outer)
    return tuple(circle_points_mm(pattern.centres_mm, radius).reshape(-1, 2) for radius in radii)


def blocks_of_pixels(
    chosen: SelectedPixels, pose: Pose, lens: AbstractLens, pattern: Pattern | SquareSheet
) -> Blocks:
    """Assign each pixel to the block of the nearest circle or node."""
    middle = np.asarray(project_to_image(pose, lens, pattern.centres_mm))
    uv_px = np.stack([chosen.column, chosen.row], axis=1)
    tree = point_tree(middle)
    block = np.asarray(tree.query(uv_px)[1])
    half_pitch = 0.5 * float(np.median(np.asarray(tree.query(middle, 2)[0])[:, 1]))
    offset = (uv_px - middle[block]) / half_pitch
    return Blocks(block, np.column_stack([np.ones(len(uv_px)), offset]), len(middle))


def _drawing(pattern: Pattern | SquareSheet) -> InkDrawing:
    if isinstance(pattern, SquareSheet):
        return InkDrawing(SQUARES, False)
    return InkDrawing(pattern.line_style, bool((pattern.inner_radius_mm > 0).any()))


def _cross(pattern: Pattern | SquareSheet) -> Cross:
    if isinstance(pattern, SquareSheet):
        return Cross(np.zeros(()), np.zeros(2), np.zeros(()))
    return Cross(
        np.asarray(0.5 * pattern.line_width_mm),
        np.array(pattern.line_half_length_mm, dtype=np.float64),
        np.asarray(float(pattern.line_gap_mm)),
    )


def _shifts(
    chosen: SelectedPixels, pose: Pose, lens: AbstractLens, shift: ImageShift | None
) -> Float[np.ndarray, "_n 2"] | None:
    """Known displacement of the sheet's image at each pixel."""
    if shift is None or not len(chosen.row):
        return None
    # Fixed-point iteration: the displacement is a function of the point before it.
    shift_px = np.zeros((len(chosen.row), 2))
    for _ in range(_SHIFT_ROUNDS):
        column, row = chosen.column - shift_px[:, 0], chosen.row - shift_px[:, 1]
        shift_px = shift(sheet_points_of_pixels(column, row, pose, lens)[0])
    return shift_px


def _cut_out(image: Float[np.ndarray, "h w"], choice: PixelSelection) -> Float[np.ndarray, "k l"]:
    (row, column), (height, width) = choice.corner, choice.flat.shape
    return image[row : row + height, column : column + width]
