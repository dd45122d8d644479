"""A picture before the sensor: one grey level per pixel, many where an edge crosses it.

Each pixel that an outline may cross is divided into S x S cells, each with a ray at its centre;
the others hold the grey level at their centre.
"""

from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry import Camera, project, sheet_from_pixel, viewing_direction
from trinoc.numerics import ArrayLike, in_float64
from trinoc.synth.layers import Layer

_CHUNK = 65536


class Canvas(eqx.Module):
    """Where the samples of a picture lie on the sheet.

    Fields
    ------
    margin_px : the canvas reaches this many pixels past the picture on every side, so that
        the blur at the picture's edge mixes in what lies outside.
    centres_mm : (h, w, 2) point of the sheet at each pixel's centre; NaN above the horizon.
    divided : (m, 2) row and column, on the canvas, of each pixel that is divided.
    samples_mm : (m, s, s, 2) points of the sheet at the cells of the divided pixels.
    boxes : for each layer, the rows and columns, from and to, outside which it changes nothing.
    """

    margin_px: int
    centres_mm: Float[np.ndarray, "h w 2"]
    divided: Int[np.ndarray, "m 2"]
    samples_mm: Float[np.ndarray, "m s s 2"]
    boxes: Int[np.ndarray, "layers 2 2"]


@runtime_checkable
class SheetView(Protocol):
    """How a camera sees the print of a sheet, flat or not, in both directions."""

    @property
    def image_size_px(self) -> tuple[int, int]:
        """(width, height) of the pictures."""
        ...

    def centres_mm(self, margin_px: int) -> Float[np.ndarray, "h w 2"]:
        """(X, Y) of the print at the centres of the picture's pixels and of a margin's.

        NaN where a pixel does not show the plane of the sheet.
        """
        ...

    def cells_mm(
        self,
        centres_mm: Float[np.ndarray, "h w 2"],
        divided: Int[np.ndarray, "m 2"],
        supersampling: int,
    ) -> Float[np.ndarray, "m s s 2"]:
        """(X, Y) at the cells of some pixels of `centres_mm`, given by row and column."""
        ...

    def pixels_px(self, points_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Pixels that show points (X, Y) of the print; NaN for points behind the camera."""
        ...


class FlatView(eqx.Module):
    """A camera over a flat sheet on Z = 0, printed true to scale."""

    camera: Camera

    @property
    def image_size_px(self) -> tuple[int, int]:
        """(width, height) of the pictures."""
        return self.camera.image_size_px

    def centres_mm(self, margin_px: int) -> Float[np.ndarray, "h w 2"]:
        """See `points_on_sheet`."""
        return points_on_sheet(self.camera, pixel_grid_px(self.image_size_px, margin_px))

    def cells_mm(
        self,
        centres_mm: Float[np.ndarray, "h w 2"],
        divided: Int[np.ndarray, "m 2"],
        supersampling: int,
    ) -> Float[np.ndarray, "m s s 2"]:
        """A ray of its own for each cell."""
        margin_px = (centres_mm.shape[0] - self.image_size_px[1]) // 2
        uv = (divided[:, ::-1] - margin_px)[:, None, None, :] + cell_offsets_px(supersampling)
        return points_on_sheet(self.camera, uv)

    def pixels_px(self, points_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """See `pixels_of_sheet`."""
        return pixels_of_sheet(self.camera, points_mm)


def make_canvas(
    camera: Camera, layers: tuple[Layer, ...], *, supersampling: int, margin_px: int
) -> Canvas:
    """The canvas of a camera over a flat sheet; see `canvas_of_view`."""
    view = FlatView(camera)
    return canvas_of_view(view, layers, supersampling=supersampling, margin_px=margin_px)


def canvas_of_view(
    view: SheetView, layers: tuple[Layer, ...], *, supersampling: int, margin_px: int
) -> Canvas:
    """The canvas of a view, divided where an outline of a layer may cross a pixel."""
    centres = view.centres_mm(margin_px)
    shape = centres.shape[:2]
    outlines, whole = _outlines_in_view(layers, centres)
    outlines_px = np.split(
        view.pixels_px(np.concatenate(outlines)) + margin_px,
        np.cumsum([len(outline) for outline in outlines])[:-1],
    )
    boxes = [
        _box(outline, shape) if is_whole and layer.local else np.array([(0, 0), shape])
        for layer, outline, is_whole in zip(layers, outlines_px, whole, strict=True)
    ]
    divided = np.argwhere(_widened(_marked(np.concatenate(outlines_px), shape)))
    samples = view.cells_mm(centres, divided, supersampling)
    return Canvas(margin_px, centres, divided, samples, np.array(boxes))


def paint(
    canvas: Canvas, layers: tuple[Layer, ...], ground: float
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "m s s"]]:
    """Grey levels at the pixels' centres and at the cells of the divided pixels.

    `layers` are those that the canvas was made for, the lowest first, on a sheet that is
    `ground` all over.
    """
    centre_grey = np.full(canvas.centres_mm.shape[:2], ground)
    cell_grey = np.full(canvas.samples_mm.shape[:3], ground)
    for layer, (low, high) in zip(layers, canvas.boxes, strict=True):
        patch = (slice(low[0], high[0]), slice(low[1], high[1]))
        cells = ((canvas.divided >= low) & (canvas.divided < high)).all(axis=1)
        centre_grey[patch] = layer.over(centre_grey[patch], canvas.centres_mm[patch])
        cell_grey[cells] = layer.over(cell_grey[cells], canvas.samples_mm[cells], cells=True)
    return centre_grey, cell_grey


def pixel_grid_px(image_size_px: tuple[int, int], margin_px: int) -> Float[np.ndarray, "h w 2"]:
    """(u, v) of every pixel of a picture and of a margin round it."""
    width, height = image_size_px
    columns = np.arange(-margin_px, width + margin_px, dtype=np.float64)
    rows = np.arange(-margin_px, height + margin_px, dtype=np.float64)
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def cell_offsets_px(supersampling: int) -> Float[np.ndarray, "s s 2"]:
    """Offsets (du, dv) of the cells' centres from the pixel's."""
    offset = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    return np.stack(np.meshgrid(offset, offset), axis=-1)


def points_on_sheet(camera: Camera, uv_px: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """(X, Y) in mm where the rays of pixels meet Z = 0; NaN where they do not."""
    return _in_chunks(_sheet_points, camera, uv_px)


def pixels_of_sheet(
    camera: Camera, points_mm: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Pixels that image points (X, Y) of the sheet; NaN for points behind the camera."""
    return _in_chunks(_sheet_pixels, camera, points_mm)


@eqx.filter_jit
def _sheet_points(camera: Camera, uv_px: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "n 2"]:
    def one(uv: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        meets = viewing_direction(camera, uv)[2] * camera.pose.centre_world_mm[2] < 0
        return jnp.where(meets, sheet_from_pixel(camera, uv), jnp.nan)

    return jax.vmap(one)(uv_px)


@eqx.filter_jit
def _sheet_pixels(camera: Camera, points_mm: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "n 2"]:
    def one(point: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        world = jnp.append(point, 0.0)
        depth = camera.cam_from_world[2, :3] @ world + camera.cam_from_world[2, 3]
        return jnp.where(depth > 0, project(camera, world), jnp.nan)

    return jax.vmap(one)(points_mm)


@in_float64
def _in_chunks(function, camera: Camera, points: np.ndarray) -> np.ndarray:
    # Pieces of one length, so that a picture with other edges does not compile again.
    flat = points.reshape(-1, 2)
    pieces = []
    for start in range(0, len(flat), _CHUNK):
        piece = flat[start : start + _CHUNK]
        padding = np.zeros((_CHUNK - len(piece), 2))
        pieces.append(np.asarray(function(camera, np.concatenate([piece, padding])))[: len(piece)])
    return np.concatenate(pieces).reshape(points.shape) if pieces else points.copy()


def _outlines_in_view(
    layers: tuple[Layer, ...], centres_mm: Float[np.ndarray, "h w 2"]
) -> tuple[list[Float[np.ndarray, "_ 2"]], list[bool]]:
    """The layers' outlines as far as they can be seen, and whether that is all of each.

    Neighbouring points are a third of the smallest pixel apart.
    """
    across = np.linalg.norm(np.diff(centres_mm, axis=1), axis=-1)
    down = np.linalg.norm(np.diff(centres_mm, axis=0), axis=-1)
    step = float(min(np.nanmin(across), np.nanmin(down))) / 3
    low, high = np.nanmin(centres_mm, axis=(0, 1)), np.nanmax(centres_mm, axis=(0, 1))
    outlines, whole = [], []
    for layer in layers:
        outline = layer.outline_mm(step)
        near = ((outline >= low) & (outline <= high)).all(axis=1)
        outlines.append(outline[near])
        whole.append(bool(near.all()) and len(outline) > 0)
    return outlines, whole


def _marked(uv_px: Float[np.ndarray, "n 2"], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """The pixels that hold one of the points."""
    height, width = shape
    inside = ((uv_px > -0.5) & (uv_px < (width - 0.5, height - 0.5))).all(axis=1)
    pixel = np.rint(uv_px[inside]).astype(np.int64)
    marked = np.zeros(shape, dtype=bool)
    marked[pixel[:, 1], pixel[:, 0]] = True
    return marked


def _widened(crossed: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Marked pixels and their eight neighbours: a curve may clip a corner between two points."""
    rows = crossed.copy()
    rows[1:] |= crossed[:-1]
    rows[:-1] |= crossed[1:]
    both = rows.copy()
    both[:, 1:] |= rows[:, :-1]
    both[:, :-1] |= rows[:, 1:]
    return both


def _box(uv_px: Float[np.ndarray, "n 2"], shape: tuple[int, int]) -> Int[np.ndarray, "2 2"]:
    """Rows and columns, from and to, of the canvas that hold points, a pixel to spare."""
    if not np.isfinite(uv_px).all():
        return np.array([(0, 0), shape])
    low = np.clip(np.floor(uv_px.min(axis=0))[::-1] - 1, 0, shape)
    high = np.clip(np.ceil(uv_px.max(axis=0))[::-1] + 2, 0, shape)
    return np.stack([low, high]).astype(np.int64)
