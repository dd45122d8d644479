"""Images of the reference sheet, and the model's prediction for their pixels."""

from functools import partial

import jax
import numpy as np

from simulation.camera_picture.render import render_sheet
from tests.calib.simulated import LENS, TABLE_1, camera_of
from trinoc.calib.photometric.equations import Group, ImageData, PixelRows, pixel_rows
from trinoc.calib.photometric.ink import SQUARES, Cross, InkDrawing
from trinoc.calib.photometric.noise import Saturation
from trinoc.calib.photometric.pixel_selection import pad_group, select_pixels
from trinoc.calib.photometric.sheet_geometry import sheet_from_camera
from trinoc.calib.photometric.unknowns import ImageState, ideal_state
from trinoc.calib.result.degrees import pose_of_values
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry import Pose

RIGHT = (*TABLE_1["right"], 0.0, 0.0)
CROSS = Cross(np.array(0.5), np.array([55.0, 55.0]), np.array(1.5))
BLUR_PX, PAPER, INK = 0.7, 230.0, 25.0
SIGMA_PX = float(np.hypot(BLUR_PX, np.sqrt(1 / 12)))
REACH_PX = 3 * SIGMA_PX + 0.4


def pose_of(values: tuple[float, ...]) -> Pose:
    return pose_of_values(np.array(values))


def state_at(values: tuple[float, ...]) -> ImageState:
    """Image state of the camera that takes the images here, at these pose values."""
    return ideal_state(pose_of(values), SIGMA_PX, INK / PAPER - 1, np.array([PAPER]))


def with_appearance(state: ImageState, **values_by_name: float) -> ImageState:
    values = np.array(state.values)
    values[state.unknowns.indices(*values_by_name)] = list(values_by_name.values())
    return ImageState(state.pose, values, state.levels, state.unknowns)


def image_of(pattern: Pattern, values: tuple[float, ...], supersampling: int = 16) -> np.ndarray:
    """Noiseless image by the renderer, which is independent of the model."""
    return render_sheet(
        pattern,
        camera_of(values[:4], LENS, (values[4], values[5])),
        blur_px=BLUR_PX,
        supersampling=supersampling,
        bits=None,
    )


def pixels_of(
    picture: np.ndarray, pattern: Pattern | SquareSheet, *, near_line: bool = False
) -> tuple[Group, int]:
    """Pixels near edges of a sheet at RIGHT in double precision, and how many there are."""
    choice = select_pixels(pose_of(RIGHT), LENS.lens, pattern, LENS.image_size_px, REACH_PX)
    selected = choice.near_lines if near_line else choice.near_circles
    capacity = max(len(selected.row), 1)
    return pad_group(selected, picture, LENS.lens, pattern, capacity, np.float64), len(selected.row)


def picture_of(
    near_circles: Group, near_lines: Group, *, state: ImageState, top: float = np.inf
) -> ImageData:
    prior = state.unknowns.prior(TUNING.photometric, local=False)
    saturation = Saturation(np.array(top), np.array(TUNING.photometric.cut_off_levels))
    return ImageData(near_circles, near_lines, CROSS, np.array(255.0), saturation, prior)


@partial(jax.jit, static_argnames=("drawing", "near_line"))
def rows_of(
    state: ImageState,
    group: Group,
    homography: np.ndarray | None = None,
    *,
    drawing: InkDrawing,
    near_line: bool = False,
) -> PixelRows:
    """Residuals and derivative rows of a group, by default at the homography of the state."""
    sheet_homography = sheet_from_camera(state.pose) if homography is None else homography
    picture = picture_of(group, group, state=state)
    return pixel_rows(sheet_homography, state, group, picture, drawing, near_line)


def drawing_of(pattern: Pattern | SquareSheet) -> InkDrawing:
    if isinstance(pattern, SquareSheet):
        return InkDrawing(SQUARES, False)
    return InkDrawing(pattern.line_style, bool((pattern.inner_radius_mm > 0).any()))
