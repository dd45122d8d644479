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
    """Division of the sheet into blocks, one around each circle or grid node.

    Attributes
    ----------
    of_pixel : (n,) index of the block of each pixel, which is that of the nearest circle or node.
    basis : (n, 3) values 1, x, y of each pixel; x and y are relative to the block's centre, in
        halves of the distance between block centres.
    count : number of blocks.
    """

    of_pixel: Int[np.ndarray, "n"]
    basis: Float[np.ndarray, "n 3"]
    count: int

    def subset(self, index: Int[np.ndarray, "m"]) -> "Blocks":
        """Blocks of the pixels at the given indices."""
        return Blocks(self.of_pixel[index], self.basis[index], self.count)


class PixelScene(NamedTuple):
    """Pixels and constants of the fit of one image.

    Attributes
    ----------
    groups : padded pixels near circles only, and padded pixels near lines.
    counts : number of pixels in each of the two groups, without padding.
    pixels : the n pixels of both groups.
    grey : (n,) observed grey levels.
    noise_scale : (n,) factor by which the scaling of a mosaic multiplied the noise; else 1.
    noise_floor : standard deviation of the noise in flat parts of the image, grey levels.
    cross, drawing : crossed lines and properties of the sheet.
    model : parameters of the pose that are estimated.
    white : grey level of a full signal.
    top : saturation level; infinity if the image is not saturated.
    tuning : constants of the fit.
    response_bend : curvature of a known response (0 linear, 1 sRGB); None if it is estimated.
    blocks : blocks of the n pixels; None until a fit needs them.
    has_local_light : True if the light of each block is estimated.
    """

    groups: tuple[Group, Group]
    counts: tuple[int, int]
    pixels: SelectedPixels
    grey: Float[np.ndarray, "n"]
    noise_scale: Float[np.ndarray, "n"]
    noise_floor: float
    cross: Cross
    drawing: InkDrawing
    model: PoseModel
    white: float
    top: float
    tuning: PhotometricTuning
    response_bend: float | None = None
    blocks: Blocks | None = None
    has_local_light: bool = False

    @property
    def grid(self) -> PixelGrid:
        """Lookup of neighbouring pixels."""
        return PixelGrid(self.pixels.column, self.pixels.row, self.tuning.shared_reach_px)

    @property
    def saturation(self) -> Saturation:
        """Saturation level, with the noise assumed for clipped pixels."""
        return Saturation(np.asarray(self.top), np.asarray(self.tuning.cut_off_levels))

    def first(self, share: int) -> "PixelScene":
        """Scene with the first 1/`share` of the pixels of each group.

        They cover the sheet evenly.
        """
        chunks = [-(-count // (share * CHUNK)) for count in self.counts]
        circles, lines = (min(n * CHUNK, c) for n, c in zip(chunks, self.counts, strict=True))
        part = np.concatenate([np.arange(circles), self.counts[0] + np.arange(lines)])
        return self._replace(
            groups=tuple(
                group._replace(chunks=np.asarray(count, dtype=np.int32))
                for group, count in zip(self.groups, chunks, strict=True)
            ),
            counts=(circles, lines),
            pixels=self.pixels.subset(part),
            grey=self.grey[part],
            noise_scale=self.noise_scale[part],
            blocks=None if self.blocks is None else self.blocks.subset(part),
        )

    def join_pixels(self, parts: Sequence[ArrayLike]) -> np.ndarray:
        """Join one array per group, with pixels along the first axis, and remove the padding."""
        groups = zip(parts, self.counts, strict=True)
        return np.concatenate([np.asarray(part)[:count] for part, count in groups])

    def join(self, parts: tuple[ArrayLike, ArrayLike]) -> np.ndarray:
        """Join one array per group, with chunks along the first axis and pixels along the last.

        Returns
        -------
        Array with the pixels of both groups along the last axis, without padding.
        """
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
        """Data of the image as arguments of the compiled programs.

        Parameters
        ----------
        unknowns : set of the unknowns of the image.
        weight : (n,) reciprocal standard deviation of each residual; 0 for outliers.
        sigma : (n,) standard deviation of the noise before saturation.
        """
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
        """Grey level of the paper at each pixel, (n,), without the local light of blocks."""
        position = self.join_pixels([group.pixels.position for group in self.groups]).T
        return np.asarray(state.light) @ np.asarray(light_terms(position, len(state.light)))


def _pad_values(values: np.ndarray, padding: float, group: Group) -> np.ndarray:
    """Pad an array to the number of pixels of a padded group; `padding` is the value added."""
    grey = group.pixels.grey
    array = np.full((len(grey), *values.shape[1:]), padding, grey.dtype)
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
    """Select the pixels of an image, and make the initial state of an ideal camera.

    For the parameters see `trinoc.calib.photometric.image_fit.refine_image`.

    Returns
    -------
    Scene and initial state; None if paper and ink have too little contrast.
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
    selection = select_pixels(start, lens, pattern, size, _reach_px(state, tuning))
    parts = (selection.near_circles, selection.near_lines)
    groups = [
        pad_group(
            part, image, lens, pattern, capacity, np.float32, _shifts(part, start, lens, shift)
        )
        for part, capacity in zip(parts, padded_capacities(*parts), strict=True)
    ]
    # All programs use them: transfer them to the device once.
    groups = jax.device_put(groups)
    pixels = jax.tree.map(lambda *pair: np.concatenate(pair), *parts)
    grey = image[pixels.image_index]
    scene = PixelScene(
        (groups[0], groups[1]),
        (len(parts[0].row), len(parts[1].row)),
        pixels,
        grey.astype(np.float64),
        noise_scale[pixels.image_index].astype(np.float64),
        noise_sigma(_cut_out(image, selection), flat=selection.flat),
        _cross(pattern),
        _drawing(pattern),
        model,
        white_level(image),
        saturation_level(grey, tuning.piled_share),
        tuning,
        encoding.response_bend,
    )
    return scene, state


def _reach_px(state: ImageState, tuning: PhotometricTuning) -> float:
    """Largest distance of a selected pixel from an edge, px."""
    return tuning.reach_sigmas * float(state["sigma_px"]) + tuning.reach_px


def first_guess(
    image: Float[np.ndarray, "h w"], pose: Pose, lens: AbstractLens, pattern: Pattern | SquareSheet
) -> ImageState:
    """Initial state of an ideal camera, from medians over all circles or squares.

    The levels of ink and paper are read at points inside and beside the circles or squares. The
    blur follows from the gradient at their edges.

    Parameters
    ----------
    image : grey levels.
    pose, lens : approximate camera, which predicts the positions of ink, edges and paper.
    pattern : the sheet, or the raster of a board of squares.
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
    """Points of the sheet, mm: in ink, on edges of ink, and on paper."""
    if isinstance(pattern, SquareSheet):
        return list_control_points(pattern)
    outer, inner = pattern.radius_mm, pattern.inner_radius_mm
    radii = (0.5 * (outer + inner), outer, outer + 0.3 * outer)
    return tuple(circle_points_mm(pattern.centres_mm, radius).reshape(-1, 2) for radius in radii)


def blocks_of_pixels(
    pixels: SelectedPixels, pose: Pose, lens: AbstractLens, pattern: Pattern | SquareSheet
) -> Blocks:
    """Assign each pixel to the block of the nearest circle or grid node.

    Parameters
    ----------
    pixels : the pixels.
    pose, lens : camera, which predicts the positions of the circles or nodes.
    pattern : the sheet, or the raster of a board of squares.
    """
    middle = np.asarray(project_to_image(pose, lens, pattern.centres_mm))
    uv_px = np.stack([pixels.column, pixels.row], axis=1)
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
    pixels: SelectedPixels, pose: Pose, lens: AbstractLens, shift: ImageShift | None
) -> Float[np.ndarray, "_n 2"] | None:
    """Known displacement of the sheet's image at each pixel, px; None without a displacement."""
    if shift is None or not len(pixels.row):
        return None
    # Fixed-point iteration: the displacement is a function of the point before it.
    shift_px = np.zeros((len(pixels.row), 2))
    for _ in range(_SHIFT_ROUNDS):
        column, row = pixels.column - shift_px[:, 0], pixels.row - shift_px[:, 1]
        shift_px = shift(sheet_points_of_pixels(column, row, pose, lens)[0])
    return shift_px


def _cut_out(
    image: Float[np.ndarray, "h w"], selection: PixelSelection
) -> Float[np.ndarray, "k l"]:
    (row, column), (height, width) = selection.corner, selection.flat.shape
    return image[row : row + height, column : column + width]
