"""Grey levels of pixels near a line."""

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped


def nearest_levels(
    picture: Float[np.ndarray, "h w"],
    u_px: Float[np.ndarray, "*n"],
    v_px: Float[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n"]:
    """Grey levels of the nearest pixels; outside the image, those of the nearest border pixel."""
    height, width = picture.shape
    column, row = (
        np.rint(coordinate).astype(np.int32).clip(0, side - 1)
        for coordinate, side in ((u_px, width), (v_px, height))
    )
    return picture.ravel()[row * width + column]


def list_pixels_across(
    at_px: Int[np.ndarray, "*n 2"], along_u: Bool[np.ndarray, "*n"], half: int
) -> Int[np.ndarray, "*n p 2"]:
    """(column, row) of a pixel and its `half` neighbours on either side, across an edge.

    Parameters
    ----------
    at_px : (..., 2)
        Middle pixels.
    along_u : (...)
        True: neighbours in the same row. False: in the same column.
    half : int
        Number of neighbours on either side.
    """
    steps = np.arange(-half, half + 1)
    pixels = np.empty((*along_u.shape, len(steps), 2), at_px.dtype)
    for axis, along in enumerate((along_u, ~along_u)):
        np.add(at_px[..., None, axis], steps * along[..., None], out=pixels[..., axis])
    return pixels


def take_levels(
    picture: Shaped[np.ndarray, "h w"], pixels: Int[np.ndarray, "*n 2"]
) -> tuple[Shaped[np.ndarray, "*n"], Bool[np.ndarray, "*n"]]:
    """(level, True if inside the image) of pixels.

    Outside the image, the level of the nearest border pixel is returned.
    """
    height, width = picture.shape
    column, row = np.moveaxis(pixels, -1, 0)
    near_column, near_row = np.clip(column, 0, width - 1), np.clip(row, 0, height - 1)
    inside = (column == near_column) & (row == near_row)
    return picture[near_row, near_column], np.asarray(inside)
