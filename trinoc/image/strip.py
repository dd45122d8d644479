"""Grey levels of pixels near a line."""

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped


def nearest_levels(
    picture: Float[np.ndarray, "h w"],
    u_px: Float[np.ndarray, "*n"],
    v_px: Float[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n"]:
    """Grey levels of the pixels nearest to image positions.

    For a position outside the image, the level of the nearest border pixel is returned.

    Parameters
    ----------
    picture : (h, w)
        Grey levels.
    u_px, v_px : (...)
        Positions.
    """
    height, width = picture.shape
    column, row = (
        np.rint(coordinate).astype(np.int32).clip(0, side - 1)
        for coordinate, side in ((u_px, width), (v_px, height))
    )
    return picture.ravel()[row * width + column]


def list_pixels_across(
    at_px: Int[np.ndarray, "*n 2"], along_u: Bool[np.ndarray, "*n"], half: int
) -> Int[np.ndarray, "*n p 2"]:
    """Pixels across an edge: a middle pixel and `half` neighbours on either side.

    Parameters
    ----------
    at_px : (..., 2)
        Middle pixels (column, row).
    along_u : (...)
        True: neighbours in the same row. False: neighbours in the same column.
    half : int
        Number of neighbours on either side.

    Returns
    -------
    (..., 2 half + 1, 2)
        Pixels (column, row).
    """
    steps = np.arange(-half, half + 1)
    pixels = np.empty((*along_u.shape, len(steps), 2), at_px.dtype)
    for axis, along in enumerate((along_u, ~along_u)):
        np.add(at_px[..., None, axis], steps * along[..., None], out=pixels[..., axis])
    return pixels


def take_levels(
    picture: Shaped[np.ndarray, "h w"], pixels: Int[np.ndarray, "*n 2"]
) -> tuple[Shaped[np.ndarray, "*n"], Bool[np.ndarray, "*n"]]:
    """Grey levels of pixels, and the mask of the pixels that are inside the image.

    For a pixel outside the image, the level of the nearest border pixel is returned.

    Parameters
    ----------
    picture : (h, w)
        Grey levels.
    pixels : (..., 2)
        Pixels (column, row).
    """
    height, width = picture.shape
    column, row = np.moveaxis(pixels, -1, 0)
    near_column, near_row = np.clip(column, 0, width - 1), np.clip(row, 0, height - 1)
    inside = (column == near_column) & (row == near_row)
    return picture[near_row, near_column], np.asarray(inside)
