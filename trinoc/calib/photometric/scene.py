"""The pixels of one picture that its fit looks at, chosen at its start, and their surroundings."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.photometric.encoding import Encoding, balance_mosaic
from trinoc.calib.photometric.equations import (
    CHUNK,
    Group,
    LocalPixels,
    Picture,
    light_terms,
)
from trinoc.calib.photometric.ink import SQUARES, Cross, InkDrawing
from trinoc.calib.photometric.noise import (
    OnGrid,
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
from trinoc.calib.photometric.sheet_places import (
    circle_points_mm,
    places_of_pixels,
    project_to_image,
)
from trinoc.calib.photometric.square_pixels import list_control_places
from trinoc.calib.photometric.unknowns import PictureState, Unknowns, ideal_state
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.image.noise import noise_sigma
from trinoc.numerics.joins import point_tree
from trinoc.numerics.precision import ArrayLike

# numerical: of an iteration that converges.
_SHIFT_ROUNDS = 3
# numerical: a central difference over two pixels sees an edge as if blurred by so much more.
_DIFFERENCE_VARIANCE = 1 / 3
_LEAST_SIGMA_PX, _LARGEST_SIGMA_PX = 0.4, 8.0  # numerical: limits of a start

# Of places of the sheet in mm, in px.
ShiftOfPlaces = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2"]]


class Blocks(NamedTuple):
    """Which block of the sheet each pixel belongs to: what lies nearest to one circle.

    Fields
    ------
    of_pixel : (n,) index of the block.
    basis : (n, 3) of each pixel (1, x, y) about its block's middle, in half pitches.
    count : number of blocks.
    """

    of_pixel: Int[np.ndarray, "n"]
    basis: Float[np.ndarray, "n 3"]
    count: int

    def part(self, chosen: Int[np.ndarray, "m"]) -> "Blocks":
        """Of some pixels only."""
        return Blocks(self.of_pixel[chosen], self.basis[chosen], self.count)


class PixelScene(NamedTuple):
    """Everything about one picture that a fit holds fixed.

    Fields
    ------
    groups, counts : pixels near circles only and near lines, padded, and how many of each count.
    chosen : the (n) pixels of both.
    grey : (n,) observed.
    noise_scale : (n,) noise of a pixel over that of others of the same level.
    noise_floor : noise of the picture's flat parts.
    cross, drawing, model : of the sheet, and what is free of the pose.
    white, top : grey level of a full signal, and where saturation cuts (infinity: nowhere).
    tuning : constants of the fit.
    bend : of the response where it is known (0 linear, 1 sRGB), None where it is fitted.
    blocks : of the (n) pixels, once a fit needs them.
    local : whether each has light of its own.
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
    local: bool = False

    @property
    def grid(self) -> OnGrid:
        """The pixels' positions in the image."""
        return OnGrid(self.chosen.column, self.chosen.row, self.tuning.shared_reach_px)

    @property
    def saturation(self) -> Saturation:
        """Saturation of the image, with the noise that clipped pixels are given."""
        return Saturation(np.asarray(self.top), np.asarray(self.tuning.cut_off_levels))

    def first(self, share: int) -> "PixelScene":
        """The first of `share` parts of the pixels, which cover the sheet as all do."""
        chunks = [-(-count // (share * CHUNK)) for count in self.counts]
        few, many = (min(n * CHUNK, c) for n, c in zip(chunks, self.counts, strict=True))
        part = np.concatenate([np.arange(few), self.counts[0] + np.arange(many)])
        return self._replace(
            groups=tuple(
                group._replace(chunks=np.asarray(count, dtype=np.int32))
                for group, count in zip(self.groups, chunks, strict=True)
            ),
            counts=(few, many),
            chosen=self.chosen.part(part),
            grey=self.grey[part],
            noise_scale=self.noise_scale[part],
            blocks=None if self.blocks is None else self.blocks.part(part),
        )

    def join_pixels(self, parts: Sequence[ArrayLike]) -> np.ndarray:
        """Values of both groups' pixels, along the first axis, as one array without padding."""
        both = zip(parts, self.counts, strict=True)
        return np.concatenate([np.asarray(part)[:count] for part, count in both])

    def join(self, parts: tuple[ArrayLike, ArrayLike]) -> np.ndarray:
        """Values of both groups' pixels, chunk after chunk, as one array without padding."""
        whole = [
            np.moveaxis(np.asarray(part), 0, -2).reshape(*part.shape[1:-1], -1) for part in parts
        ]
        both = zip(whole, self.counts, strict=True)
        return np.concatenate([part[..., :count] for part, count in both], axis=-1)

    def picture(
        self,
        unknowns: Unknowns,
        weight: Float[np.ndarray, "n"],
        sigma: Float[np.ndarray, "n"],
    ) -> Picture:
        """The pixels with given weights and noise, as the compiled programs take them."""
        groups = []
        for k, group in enumerate(self.groups):
            part = slice(0, self.counts[0]) if k == 0 else slice(self.counts[0], None)
            places = None
            if self.local and self.blocks is not None:
                block = _pad_values(self.blocks.of_pixel[part], 0, group).astype(np.int32)
                places = LocalPixels(block, _pad_values(self.blocks.basis[part], 0.0, group))
            pixels = group.pixels._replace(
                weight=_pad_values(weight[part], 0.0, group),
                sigma=_pad_values(sigma[part], 1.0, group),
            )
            groups.append(Group(pixels, group.chunks, places))
        prior = unknowns.prior(self.tuning, local=self.local)
        white = np.asarray(self.white)
        return Picture(groups[0], groups[1], self.cross, white, self.saturation, prior)

    def polynomial_light(self, state: PictureState) -> Float[np.ndarray, "n"]:
        """The paper's grey level by the polynomial alone."""
        place = self.join_pixels([group.pixels.place for group in self.groups]).T
        return np.asarray(state.light) @ np.asarray(light_terms(place, len(state.light)))


def _pad_values(values: np.ndarray, rest: float, group: Group) -> np.ndarray:
    grey = group.pixels.grey
    array = np.full((len(grey), *values.shape[1:]), rest, grey.dtype)
    array[: len(values)] = values
    return array


def scene_of_picture(
    image: Float[np.ndarray, "h w"],
    pattern: Pattern | SquareSheet,
    lens: AbstractLens,
    start: Pose,
    model: PoseModel,
    shift: ShiftOfPlaces | None,
    encoding: Encoding,
    tuning: PhotometricTuning,
) -> tuple[PixelScene, PictureState] | None:
    """The pixels, and a first guess of an ideal camera; None where no ink shows."""
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
    # Every program of this picture takes them: they are handed over once.
    groups = jax.device_put(groups)
    chosen = jax.tree.map(lambda *pair: np.concatenate(pair), *parts)
    grey = image[chosen.places]
    scene = PixelScene(
        (groups[0], groups[1]),
        (len(parts[0].row), len(parts[1].row)),
        chosen,
        grey.astype(np.float64),
        noise_scale[chosen.places].astype(np.float64),
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


def _reach_px(state: PictureState, tuning: PhotometricTuning) -> float:
    """Largest distance of a selected pixel from an edge."""
    return tuning.reach_sigmas * float(state["sigma_px"]) + tuning.reach_px


def first_guess(
    image: Float[np.ndarray, "h w"], pose: Pose, lens: AbstractLens, pattern: Pattern | SquareSheet
) -> PictureState:
    """Medians over all places: of the paper beside, the ink inside, the steepness between."""
    outlines = _places(pattern)
    sampled = np.asarray(project_to_image(pose, lens, np.concatenate(outlines)))
    limit = np.array(image.shape[::-1]) - 1
    ends = np.cumsum([len(part) for part in outlines])[:-1]
    places = np.split(np.round(sampled).astype(int), ends)
    ink, edge, paper = (p[((p >= 1) & (p < limit)).all(axis=1)] for p in places)
    u, v = edge[:, 0], edge[:, 1]
    slope = 0.5 * np.hypot(image[v, u + 1] - image[v, u - 1], image[v + 1, u] - image[v - 1, u])
    paper_grey = float(np.median(image[paper[:, 1], paper[:, 0]]))
    ink_grey = float(np.median(image[ink[:, 1], ink[:, 0]]))
    steepest = max(float(np.median(slope)), 1e-6)
    variance = ((paper_grey - ink_grey) / (steepest * np.sqrt(2 * np.pi))) ** 2
    sigma = np.sqrt(max(variance - _DIFFERENCE_VARIANCE, _LEAST_SIGMA_PX**2))
    ratio = ink_grey / max(paper_grey, 1e-6) - 1
    return ideal_state(pose, min(sigma, _LARGEST_SIGMA_PX), ratio, np.array([paper_grey]))


def _places(pattern: Pattern | SquareSheet) -> tuple[Float[np.ndarray, "_n 2"], ...]:
    """Of the sheet: in ink, on edges, on paper."""
    if isinstance(pattern, SquareSheet):
        return list_control_places(pattern)
    outer, inner = pattern.radius_mm, pattern.inner_radius_mm
    radii = (0.5 * (outer + inner), outer, outer + 0.3 * outer)
    return tuple(circle_points_mm(pattern.centres_mm, radius).reshape(-1, 2) for radius in radii)


def blocks_of_pixels(
    chosen: SelectedPixels, pose: Pose, lens: AbstractLens, pattern: Pattern | SquareSheet
) -> Blocks:
    """The nearest circle of each pixel."""
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
