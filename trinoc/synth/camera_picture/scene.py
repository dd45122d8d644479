"""Light from the sheet toward the lens, finely divided, before anything blurs it.

Eight by eight cells to a pixel. In pixels that an edge may cross each cell is the mean of the
shares that ink, paper and table have of its area; elsewhere a pixel is all one level.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.geometry import Camera
from trinoc.synth.camera_picture.cover import Cover
from trinoc.synth.camera_picture.light import Light, light_on_sheet, passed_by_lens, reflection
from trinoc.synth.camera_picture.paper import Paper
from trinoc.synth.camera_picture.sheet_view import BentView
from trinoc.synth.canvas import canvas_of_view, paint
from trinoc.synth.sheet_image import PrintedSheet

CELLS = 8
MARGIN_PX = 16


class SheetScene(eqx.Module):
    """What is before the camera."""

    paper: Paper = Paper()
    light: Light = Light()
    covers: tuple[Cover, ...] = ()


def radiance(
    pattern: PrintedSheet, camera: Camera, scene: SheetScene
) -> Float[np.ndarray, "h_cells w_cells"]:
    """Radiance in CELLS x CELLS cells a pixel, of the picture and MARGIN_PX round it.

    1 is a perfect diffuser in full light.
    """
    view = BentView(camera, scene.paper)
    light = scene.light
    layers = (
        *scene.paper.layers(pattern),
        *(cover.layer for cover in scene.covers),
        *(shadow.layer for shadow in light.shadows),
    )
    canvas = canvas_of_view(view, layers, supersampling=CELLS, margin_px=MARGIN_PX)
    by_pixel, by_cell = paint(canvas, layers, scene.paper.paper)
    by_pixel *= light_on_sheet(light, canvas.centres_mm)
    by_cell *= light_on_sheet(light, canvas.samples_mm)
    fine = _divided(by_pixel)
    _pixels_of(fine)[canvas.divided[:, 0], :, canvas.divided[:, 1]] = by_cell
    if light.lamp is not None:
        world = view.points_world_mm(canvas.centres_mm)
        fine += _divided(reflection(light.lamp, camera, world))
    if light.vignetting:
        fine *= _divided(passed_by_lens(light, camera.image_size_px, MARGIN_PX))
    return fine


def _divided(by_pixel: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h_cells w_cells"]:
    return np.repeat(np.repeat(by_pixel, CELLS, axis=0), CELLS, axis=1)


def _pixels_of(
    fine: Float[np.ndarray, "h_cells w_cells"],
) -> Float[np.ndarray, "h c w c"]:
    """A view of the cells by pixel row, cell row, pixel column, cell column."""
    height, width = fine.shape
    return fine.reshape(height // CELLS, CELLS, width // CELLS, CELLS)
