"""ArUco and AprilTag markers from OpenCV's dictionaries.

Functions import OpenCV when they need it: matching imports the board classes and must not wait for
OpenCV to load.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool

from trinoc.calib.targets.abstract_target import Marks
from trinoc.errors import InputError

# numerical: number of markers in each dictionary, by OpenCV's name without the prefix DICT_.
_COUNTS = {
    **{f"{bits}x{bits}_{count}": count for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "ARUCO_ORIGINAL": 1024,
    "APRILTAG_16h5": 30,
    "APRILTAG_25h9": 35,
    "APRILTAG_36h10": 2320,
    "APRILTAG_36h11": 587,
}
DICTIONARIES = tuple(_COUNTS)
# numerical: side of a cell in OpenCV's drawing of a marker, px; a cell is read at its centre.
_CELL_PX = 4


def check_markers(name: str, dictionary: str, first: int, count: int) -> None:
    """Raise InputError for an unknown dictionary, or one without the board's marker numbers.

    first, count : number of the board's first marker, and how many markers the board has.
    """
    if dictionary not in DICTIONARIES:
        raise InputError(
            f"The dictionary {dictionary!r} is unknown: give one of {', '.join(DICTIONARIES)}."
        )
    last, size = first + count - 1, _COUNTS[dictionary]
    if first < 0 or (first > 0 and last >= size):
        raise InputError(
            f"The board {name!r} has the markers {first} to {last}, but "
            f"{dictionary} has 0 to {size - 1}: give another first number or dictionary."
        )


def marks_of_markers(dictionary: str, numbers: range) -> Marks:
    """Marks of a board with markers, by which an image identifies it."""
    family = _family(dictionary)
    return Marks(
        family,
        numbers,
        f"both have the marker{{numbers}} of {family}; give them different dictionaries, or "
        "numbers that differ (`first`)",
    )


def list_largest_dictionaries() -> list[str]:
    """Largest dictionary of each family, which contains the markers of the smaller ones."""
    families = {_family(name): name for name in sorted(_COUNTS, key=lambda name: _COUNTS[name])}
    return [name for name in DICTIONARIES if name in families.values()]


def smallest_dictionary(family_member: str, last: int, *, like: str) -> str | None:
    """Return the smallest dictionary of a family that contains marker `last`, or None.

    family_member : any dictionary of the family.
    like : a dictionary whose size is preferred, if it is sufficient.
    """
    family = _family(family_member)
    names = [name for name in DICTIONARIES if _family(name) == family and _COUNTS[name] > last]
    names.sort(key=lambda name: (_COUNTS[name] != _COUNTS[like], _COUNTS[name]))
    return names[0] if names else None


def _family(dictionary: str) -> str:
    """Family of a dictionary: the cell count for ArUco ("4x4"), else the name itself."""
    size, count = dictionary.split("_")
    return size if count.isdigit() else dictionary


def opencv_dictionary(name: str) -> Any:
    """OpenCV's `cv2.aruco.Dictionary` for one of the names in `DICTIONARIES`."""
    import cv2

    family, count = name.split("_")
    return cv2.aruco.getPredefinedDictionary(
        getattr(cv2.aruco, f"DICT_{family.replace('x', 'X')}_{count}")
    )


def marker_cells(dictionary: Any, number: int, *, border: int) -> Bool[np.ndarray, "k k"]:
    """Mask of a marker's inked cells, border included, top row first.

    border : width of the border in cells.
    """
    import cv2

    cells = dictionary.markerSize + 2 * border
    drawing = np.asarray(
        cv2.aruco.generateImageMarker(dictionary, number, cells * _CELL_PX, borderBits=border)
    )
    return drawing[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX] < 128
