"""Image of a sheet or board for a screen that serves as calibration target."""

import os

import numpy as np
from jaxtyping import Bool, Float, UInt8

from trinoc.calib.targets.abstract_target import AbstractBoard, Disc, Polygon
from trinoc.errors import InputError
from trinoc.io.images import write_picture
from trinoc.io.pattern_page import drawing_box_mm

# Lattice of points per pixel side, by which the ink of a pixel is counted.
_DIVISION = 16
# Rows of pixels counted at a time: bounds the memory of large screens.
_BAND_PX = 32
# White that detection needs around the ink.
_MARGIN_MM = 5.0


def screen_room_mm(size_px: tuple[int, int], pitch_mm: float) -> tuple[float, float]:
    """Largest (width, height), mm, of a drawing on a screen, with white margins.

    `size_px` is the size of the screen and `pitch_mm` the size of a pixel.
    """
    return size_px[0] * pitch_mm - 2 * _MARGIN_MM, size_px[1] * pitch_mm - 2 * _MARGIN_MM


def save_pattern_png(
    pattern: AbstractBoard,
    path: str | os.PathLike[str],
    *,
    size_px: tuple[int, int],
    pitch_mm: float,
) -> None:
    """Write the image of a board for a screen, as PNG.

    Parameters
    ----------
    pattern : AbstractBoard
        Sheet of circles or board.
    path : path
        File to write.
    size_px : (width, height)
        Size of the screen.
    pitch_mm : float
        Size of a pixel.

    Raises
    ------
    InputError
        If the drawing does not fit on the screen.
    """
    write_picture(path, pattern_picture(pattern, size_px=size_px, pitch_mm=pitch_mm))


def pattern_picture(
    pattern: AbstractBoard, *, size_px: tuple[int, int], pitch_mm: float
) -> UInt8[np.ndarray, "h w"]:
    """Image of a board for a screen with square pixels, in true scale, centred on white.

    The light of a pixel at an edge is the share of its area that is white, and its grey level
    follows from the light by sRGB (IEC 61966-2-1). A camera then images each edge at its exact
    position between pixels.

    Parameters
    ----------
    pattern : AbstractBoard
        Sheet of circles or board.
    size_px : (width, height)
        Size of the screen.
    pitch_mm : float
        Size of a pixel.

    Returns
    -------
    (h, w)
        Grey levels, uint8.

    Raises
    ------
    InputError
        If the drawing does not fit on the screen.
    """
    low, high = drawing_box_mm(pattern)
    needed, room = high - low, np.array(screen_room_mm(size_px, pitch_mm))
    if np.any(needed > room):
        size_mm = np.array(size_px) * pitch_mm
        raise InputError(
            f"The pattern {pattern.name!r} is {needed[0]:.0f} x {needed[1]:.0f} mm and needs "
            f"{_MARGIN_MM:g} mm of white around it, but the screen is {size_mm[0]:.0f} x "
            f"{size_mm[1]:.0f} mm: take a smaller pitch or fewer rows."
        )
    middle = 0.5 * (low + high)
    shapes = [_on_screen(figure, middle, size_px, pitch_mm) for figure in pattern.drawing()]
    bands = [
        _white_share(shapes, top, min(top + _BAND_PX, size_px[1]), size_px[0])
        for top in range(0, size_px[1], _BAND_PX)
    ]
    return np.rint(255 * _level(np.concatenate(bands))).astype(np.uint8)


def _on_screen(
    figure: Disc | Polygon,
    middle: Float[np.ndarray, "2"],
    size_px: tuple[int, int],
    pitch_mm: float,
) -> Disc | Polygon:
    """Convert a figure from mm to pixels, from the corner of the top-left pixel, y down.

    `middle` is the point of the drawing, mm, at the centre of the screen.
    """
    half, flip = 0.5 * np.array(size_px), np.array([1.0, -1.0]) / pitch_mm
    if isinstance(figure, Polygon):
        return figure._replace(corners_mm=half + (figure.corners_mm - middle) * flip)
    x, y = half + (np.array(figure.centre_mm) - middle) * flip
    return Disc((float(x), float(y)), figure.radius_mm / pitch_mm, figure.is_ink)


def _white_share(
    shapes: list[Disc | Polygon], top: int, bottom: int, width: int
) -> Float[np.ndarray, "h w"]:
    """Share of each pixel that is not covered by ink, (h, w), for the rows `top` to `bottom`."""
    white = np.ones(((bottom - top) * _DIVISION, width * _DIVISION), dtype=bool)
    for shape in shapes:
        low, high = _bounds(shape)
        first, last = (np.floor(low) - [0, top]), (np.ceil(high) - [0, top])
        limit = np.array([width, bottom - top])
        (left, upper), (right, lower) = (
            np.clip(side, 0, limit).astype(int) * _DIVISION for side in (first, last)
        )
        if left >= right or upper >= lower:
            continue
        x = (np.arange(left, right) + 0.5) / _DIVISION
        y = (np.arange(upper, lower) + 0.5) / _DIVISION + top
        part = white[upper:lower, left:right]
        part[_inside(shape, x[None, :], y[:, None])] = not shape.is_ink
    cells = white.reshape(bottom - top, _DIVISION, width, _DIVISION)
    return np.count_nonzero(cells, axis=(1, 3)) / _DIVISION**2


def _bounds(shape: Disc | Polygon) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    if isinstance(shape, Polygon):
        return shape.corners_mm.min(axis=0), shape.corners_mm.max(axis=0)
    centre = np.array(shape.centre_mm)
    return centre - shape.radius_mm, centre + shape.radius_mm


def _inside(
    shape: Disc | Polygon, x: Float[np.ndarray, "1 w"], y: Float[np.ndarray, "h 1"]
) -> Bool[np.ndarray, "h w"]:
    """True for grid points (x, y) inside a figure, (h, w).

    Polygons must be convex; their corners may be in either order.
    """
    if isinstance(shape, Disc):
        return np.hypot(x - shape.centre_mm[0], y - shape.centre_mm[1]) < shape.radius_mm
    corners = shape.corners_mm
    along = np.roll(corners, -1, axis=0) - corners
    turn = np.sign(along[0, 0] * along[1, 1] - along[0, 1] * along[1, 0])
    covered = np.ones((y.size, x.size), dtype=bool)
    for corner, step in zip(corners, along, strict=True):
        covered &= turn * (step[0] * (y - corner[1]) - step[1] * (x - corner[0])) > 0
    return covered


def _level(light: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Convert linear light, 0 to 1, to the sRGB level, 0 to 1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
