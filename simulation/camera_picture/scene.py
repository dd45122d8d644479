"""Light from the sheet toward the lens, finely sampled, before any blur.

A pixel that an edge may cross is divided into S x S cells, and each cell is the mean of the
shares that ink, paper and table have of its area; elsewhere a pixel is all one level.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from simulation.camera_picture.layers import Layer
from simulation.camera_picture.light import Illumination, light_on_sheet, passed_by_lens, reflection
from simulation.camera_picture.paper import Paper, SheetFigures
from simulation.camera_picture.sheet_view import SheetView
from trinoc.geometry.camera import Camera

# Edges reach pixels this far outside the picture, unless a caller knows how far light spreads.
MARGIN_PX = 16


class SheetScene(eqx.Module):
    """The scene before the camera; `covers` lie on the sheet, the lowest first."""

    paper: Paper = Paper()
    light: Illumination = Illumination()
    covers: tuple[Layer, ...] = ()


class Radiance(eqx.Module):
    """Light toward each pixel of a picture and its margin; 1 is a perfect diffuser in full light.

    Fields
    ------
    by_pixel : (h, w) the level of each pixel that is not divided, and about that of the others.
    divided : (m, 2) row and column of each pixel that is divided.
    by_cell : (m, s, s) the mean over each cell of the divided pixels.
    margin_px : by which `by_pixel` reaches past the picture on every side.
    """

    by_pixel: Float[np.ndarray, "h w"]
    divided: Int[np.ndarray, "m 2"]
    by_cell: Float[np.ndarray, "m s s"]
    margin_px: int


def radiance(
    pattern: SheetFigures,
    camera: Camera,
    scene: SheetScene,
    *,
    supersampling: int = 8,
    margin_px: int = MARGIN_PX,
) -> Radiance:
    """Light from a scene toward a camera, `supersampling` squared cells in a divided pixel."""
    view, light = SheetView(camera, scene.paper), scene.light
    layers = (*scene.paper.layers(pattern), *scene.covers, *light.shadows)
    centres = view.centres_mm(margin_px)
    divided, boxes = _find_edge_pixels(view, layers, centres, margin_px)
    cells = view.cells_mm(centres, divided, supersampling)
    by_pixel = np.full(centres.shape[:2], scene.paper.paper)
    by_cell = np.full(cells.shape[:3], scene.paper.paper)
    for layer, (low, high) in zip(layers, boxes, strict=True):
        patch = (slice(low[0], high[0]), slice(low[1], high[1]))
        in_box = ((divided >= low) & (divided < high)).all(axis=1)
        by_pixel[patch] = layer.over(by_pixel[patch], centres[patch])
        by_cell[in_box] = layer.over(by_cell[in_box], cells[in_box], cells=True)
    by_pixel *= light_on_sheet(light, centres)
    by_cell *= light_on_sheet(light, cells)
    row, column = divided.T
    if light.lamp is not None:
        spot = reflection(light.lamp, camera, view.points_world_mm(centres))
        by_pixel += spot
        by_cell += spot[row, column, None, None]
    if light.vignetting:
        passed = passed_by_lens(light, camera.image_size_px, margin_px)
        by_pixel *= passed
        by_cell *= passed[row, column, None, None]
    return Radiance(by_pixel, divided, by_cell, margin_px)


def _find_edge_pixels(
    view: SheetView,
    layers: tuple[Layer, ...],
    centres_mm: Float[np.ndarray, "h w 2"],
    margin_px: int,
) -> tuple[Int[np.ndarray, "m 2"], Int[np.ndarray, "layers 2 2"]]:
    """Row and column of the pixels that an outline may cross.

    And for each layer the rows and columns, from and to, outside which it changes nothing.
    """
    shape = centres_mm.shape[:2]
    outlines, complete = _outlines_in_view(layers, centres_mm)
    if not outlines:
        return np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2, 2), dtype=np.int64)
    outlines_px = np.split(
        view.pixels_px(np.concatenate(outlines)) + margin_px,
        np.cumsum([len(outline) for outline in outlines])[:-1],
    )
    boxes = [
        _box(outline, shape) if is_complete and layer.local else np.array([(0, 0), shape])
        for layer, outline, is_complete in zip(layers, outlines_px, complete, strict=True)
    ]
    return np.argwhere(_widen_marks(_mark_pixels(np.concatenate(outlines_px), shape))), np.array(
        boxes
    )


def _outlines_in_view(
    layers: tuple[Layer, ...], centres_mm: Float[np.ndarray, "h w 2"]
) -> tuple[list[Float[np.ndarray, "_ 2"]], list[bool]]:
    """Visible points of the layers' outlines, and for each layer whether all are visible.

    Neighbouring points are a third of the smallest pixel apart.
    """
    across = np.linalg.norm(np.diff(centres_mm, axis=1), axis=-1)
    down = np.linalg.norm(np.diff(centres_mm, axis=0), axis=-1)
    step = float(min(np.nanmin(across), np.nanmin(down))) / 3
    low, high = np.nanmin(centres_mm, axis=(0, 1)), np.nanmax(centres_mm, axis=(0, 1))
    outlines, complete = [], []
    for layer in layers:
        outline = layer.outline_mm(step)
        in_view = ((outline >= low) & (outline <= high)).all(axis=1)
        outlines.append(outline[in_view])
        complete.append(bool(in_view.all()) and len(outline) > 0)
    return outlines, complete


def _mark_pixels(
    uv_px: Float[np.ndarray, "n 2"], shape: tuple[int, int]
) -> Bool[np.ndarray, "h w"]:
    """Mask of the pixels that contain one of the points."""
    height, width = shape
    inside = ((uv_px > -0.5) & (uv_px < (width - 0.5, height - 0.5))).all(axis=1)
    pixel = np.rint(uv_px[inside]).astype(np.int64)
    marked = np.zeros(shape, dtype=bool)
    marked[pixel[:, 1], pixel[:, 0]] = True
    return marked


def _widen_marks(crossed: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Marked pixels and their eight neighbours: a curve may clip a corner between two points."""
    rows = crossed.copy()
    rows[1:] |= crossed[:-1]
    rows[:-1] |= crossed[1:]
    both = rows.copy()
    both[:, 1:] |= rows[:, :-1]
    both[:, :-1] |= rows[:, 1:]
    return both


def _box(uv_px: Float[np.ndarray, "n 2"], shape: tuple[int, int]) -> Int[np.ndarray, "2 2"]:
    """Ranges of the canvas's rows and columns that contain points, with a pixel's margin."""
    if not np.isfinite(uv_px).all():
        return np.array([(0, 0), shape])
    low = np.clip(np.floor(uv_px.min(axis=0))[::-1] - 1, 0, shape)
    high = np.clip(np.ceil(uv_px.max(axis=0))[::-1] + 2, 0, shape)
    return np.stack([low, high]).astype(np.int64)
