"""Lenses as OpenCV and many tools store them: a 3 x 3 matrix and coefficients."""

from typing import Any

import numpy as np

from trinoc.geometry.intrinsics import Intrinsics
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, make_lens
from trinoc.io.json_document import Block

# cv2.projectPoints takes 4, 5, 8, 12 or 14 coefficients in this order.
_ALL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
FISHEYE = LensRow("fisheye", "kannala_brandt", ("k1", "k2", "k3", "k4"))
WRITTEN = (
    LensRow("", "brown_conrady", _ALL[:5]),
    LensRow("", "rational", _ALL[:8]),
    LensRow("", "thin_prism", _ALL[:12]),
    FISHEYE,
)
READ = (
    *(LensRow("", model, _ALL) for model in ("brown_conrady", "rational", "thin_prism")),
    FISHEYE,
)


def matrix_of_numbers(numbers: LensNumbers) -> list[list[float]]:
    """Calibration matrix (3, 3) with the rows (fx 0 cx), (0 fy cy), (0 0 1), as lists."""
    (fx, fy), (cx, cy) = numbers.focal_px, numbers.centre_px
    return [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]


def read_opencv_lens(
    block: Block,
    matrix_key: str,
    distortion_key: str,
    size_px: tuple[int, int],
    called: str,
    where: str,
) -> Intrinsics:
    """Read a lens from a calibration matrix and OpenCV's distortion coefficients.

    Parameters
    ----------
    block : Block
        Dictionary in the file that contains both.
    matrix_key, distortion_key : str
        Keys of matrix and coefficients. Without the second key the lens has no distortion.
    size_px : (width, height)
        Size of the images.
    called : str
        Name of the model in `READ`: "" or "fisheye".
    where : str
        Beginning of the error message: the file, and the camera in the file.

    Returns
    -------
    Intrinsics

    Raises
    ------
    InputError
        If the matrix has another form, or trinoc does not have a coefficient.
    """
    matrix = block.numbers(matrix_key, (3, 3))
    if abs(matrix[2] - (0, 0, 1)).max() > 0 or matrix[1, 0] != 0 or matrix[0, 1] != 0:
        raise block.error(matrix_key, "must be fx 0 cx, 0 fy cy, 0 0 1: correct it.")
    numbers = LensNumbers(
        called,
        (matrix[0, 0], matrix[1, 1]),
        (matrix[0, 2], matrix[1, 2]),
        0.0,
        flat_numbers(block, distortion_key).tolist() if distortion_key in block.values else [],
    )
    return make_lens(numbers, size_px, READ, where)


def flat_numbers(block: Block, key: str) -> np.ndarray:
    """Numbers under a key as one array (n,): a list, or a row or column of a matrix."""
    value: Any = block.values.get(key)
    nested = isinstance(value, list) and any(isinstance(item, list) for item in value)
    return block.numbers(key, (None, None) if nested else (None,)).reshape(-1)
