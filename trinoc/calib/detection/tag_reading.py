"""Tags that touch their neighbours at the corners, found and read.

OpenCV takes what touches for one figure, so light is widened until corners part; the tags are then
read in the picture as it is. OpenCV's own reading of the widened picture finds half as many tags in
soft pictures, and next to none of tags 40 px wide.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

# How often the picture is enlarged, and the width in its pixels by which light is widened: fine
# tags need the one, soft corners the other.
_LOOKS = ((1, 3), (1, 7), (2, 5))
# Larger pictures show tags large enough.
_LARGEST_ENLARGED_PX = 4_000_000
# Pixels of a cell that is read, and those of its rim that are not.
_CELL_PX, _RIM_PX = 8, 2
# Cells of the border that may be light, and bits to correct over those that the code can.
_WRONG_BORDER, _CORRECTED = 0.1, 0.6
_LEAST_SPREAD = 10.0


def read_tags(
    grey: UInt8[np.ndarray, "h w"], dictionary: cv2.aruco.Dictionary, border: int
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Corners of each tag by number, from its top left clockwise in the picture, some px off.

    A number that is read at two places is left out: one of them belongs to another board.
    """
    found: dict[int, Float[np.ndarray, "4 2"]] = {}
    twice = set()
    for scale, wide in _LOOKS:
        if scale > 1 and grey.size > _LARGEST_ENLARGED_PX:
            continue
        large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        for corners in _find_quadrangles(large, dictionary, border, wide):
            read = _read_tag(large, corners, dictionary, border)
            if read is None:
                continue
            number, turn = read
            # The middle of the first pixel stays the middle of the first pixel.
            place = (np.roll(corners, turn, axis=0) + 0.5) / scale - 0.5
            known = found.setdefault(number, place)
            side = float(np.linalg.norm(np.diff(known, axis=0), axis=1).min())
            if np.linalg.norm(known.mean(axis=0) - place.mean(axis=0)) > 0.5 * side:
                twice.add(number)
    return {number: corners for number, corners in found.items() if number not in twice}


def _find_quadrangles(
    grey: UInt8[np.ndarray, "h w"], dictionary: cv2.aruco.Dictionary, border: int, wide: int
) -> list[Float[np.ndarray, "4 2"]]:
    """What might be a tag, read or not, at the size that it has without the wider light."""
    options = cv2.aruco.DetectorParameters()
    options.markerBorderBits = border
    parted = cv2.dilate(grey, np.ones((wide, wide), np.uint8))
    read, _, others = cv2.aruco.ArucoDetector(dictionary, options).detectMarkers(parted)
    figures = []
    for figure in (*read, *others):
        corners = np.asarray(figure, dtype=np.float64).reshape(4, 2)
        side = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean()
        middle = corners.mean(axis=0)
        figures.append(middle + (corners - middle) * (1 + (wide - 1) / side))
    return figures


def _read_tag(
    grey: UInt8[np.ndarray, "h w"],
    corners: Float[np.ndarray, "4 2"],
    dictionary: cv2.aruco.Dictionary,
    border: int,
) -> tuple[int, int] | None:
    """(number, by how many corners the tag is turned); None for what is no tag."""
    cells = dictionary.markerSize + 2 * border
    side = cells * _CELL_PX
    square = side * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32) - 0.5
    to_square = cv2.getPerspectiveTransform(corners.astype(np.float32), square)
    flat = cv2.warpPerspective(grey, to_square, (side, side))
    if flat.std() < _LEAST_SPREAD:
        return None
    light = cv2.threshold(flat, 0, 1, cv2.THRESH_OTSU)[1]
    middle = slice(_RIM_PX, _CELL_PX - _RIM_PX)
    share = light.reshape(cells, _CELL_PX, cells, _CELL_PX)[:, middle, :, middle].mean(axis=(1, 3))
    bits: Bool[np.ndarray, "c c"] = share > 0.5
    code = bits[border:-border, border:-border]
    if bits.sum() - code.sum() > _WRONG_BORDER * (bits.size - code.size):
        return None
    is_one, number, turn = dictionary.identify(code.astype(np.uint8), _CORRECTED)
    return (int(number), int(turn)) if is_one else None
