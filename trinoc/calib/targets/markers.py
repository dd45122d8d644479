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
    """Raise `InputError` if a dictionary is unknown, or does not contain all marker ids of a board.

    Parameters
    ----------
    name : name of the board, for the message.
    dictionary : name of the dictionary.
    first, count : id of the board's first marker, and number of its markers.
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


def marks_of_markers(dictionary: str, ids: range) -> Marks:
    """Marker family and ids, by which an image distinguishes a board from other boards.

    Parameters
    ----------
    dictionary : name of the dictionary.
    ids : ids of the board's markers.
    """
    family = _family(dictionary)
    return Marks(
        family,
        ids,
        f"both have the marker{{numbers}} of {family}; give them different dictionaries, or "
        "numbers that differ (`first`)",
    )


def list_largest_dictionaries() -> list[str]:
    """Names of the largest dictionary of each family.

    It contains all markers of the smaller dictionaries of the family.
    """
    families = {_family(name): name for name in sorted(_COUNTS, key=lambda name: _COUNTS[name])}
    return [name for name in DICTIONARIES if name in families.values()]


def smallest_dictionary(family_member: str, last: int, *, like: str) -> str | None:
    """Name of the smallest dictionary of a family that contains a marker id; None without one.

    Parameters
    ----------
    family_member : name of any dictionary of the family.
    last : the marker id.
    like : name of a dictionary whose size is preferred, if it is sufficient.
    """
    family = _family(family_member)
    names = [name for name in DICTIONARIES if _family(name) == family and _COUNTS[name] > last]
    names.sort(key=lambda name: (_COUNTS[name] != _COUNTS[like], _COUNTS[name]))
    return names[0] if names else None


def _family(dictionary: str) -> str:
    """Name of a dictionary's family.

    It is the number of cells for ArUco, such as "4x4", and the name of the dictionary for others.
    """
    size, count = dictionary.split("_")
    return size if count.isdigit() else dictionary


def opencv_dictionary(name: str) -> Any:
    """OpenCV's `cv2.aruco.Dictionary` for a name in `DICTIONARIES`.

    Parameters
    ----------
    name : name of the dictionary.
    """
    import cv2

    family, count = name.split("_")
    return cv2.aruco.getPredefinedDictionary(
        getattr(cv2.aruco, f"DICT_{family.replace('x', 'X')}_{count}")
    )


def marker_cells(dictionary: Any, marker_id: int, *, border: int) -> Bool[np.ndarray, "k k"]:
    """Mask of the inked cells of a marker including its border, (k, k), top row first.

    Parameters
    ----------
    dictionary : OpenCV's dictionary.
    marker_id : id of the marker.
    border : width of the border in cells.
    """
    import cv2

    cells = dictionary.markerSize + 2 * border
    drawing = np.asarray(
        cv2.aruco.generateImageMarker(dictionary, marker_id, cells * _CELL_PX, borderBits=border)
    )
    return drawing[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX] < 128
