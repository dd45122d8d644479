"""ArUco's and AprilTag's markers, by OpenCV's dictionaries.

OpenCV loads when a marker is drawn or looked for: matching needs boards' types, and no OpenCV.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool

from trinoc.calib.targets.abstract_target import Marks
from trinoc.errors import InputError

# numerical: how many markers a dictionary holds, by OpenCV's name without the prefix DICT_.
_COUNTS = {
    **{f"{bits}x{bits}_{count}": count for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "ARUCO_ORIGINAL": 1024,
    "APRILTAG_16h5": 30,
    "APRILTAG_25h9": 35,
    "APRILTAG_36h10": 2320,
    "APRILTAG_36h11": 587,
}
DICTIONARIES = tuple(_COUNTS)
# numerical: pixels of OpenCV's drawing for one cell, which is read in its middle.
_CELL_PX = 4


def check_markers(name: str, dictionary: str, first: int, count: int) -> None:
    """Raises InputError where the dictionary is unknown or lacks the numbers of a board."""
    if dictionary not in DICTIONARIES:
        raise InputError(
            f"The dictionary {dictionary!r} is unknown: give one of {', '.join(DICTIONARIES)}."
        )
    last, held = first + count - 1, _COUNTS[dictionary]
    if first < 0 or (first > 0 and last >= held):
        raise InputError(
            f"The board {name!r} has the markers {first} to {last}, but "
            f"{dictionary} has 0 to {held - 1}: give another first one or dictionary."
        )


def marks_of_markers(dictionary: str, numbers: range) -> Marks:
    """What identifies a board with markers."""
    family = _family(dictionary)
    return Marks(
        family,
        numbers,
        f"both have the marker{{numbers}} of {family}; give them different dictionaries, or "
        "numbers that differ (`first`)",
    )


def list_largest_dictionaries() -> list[str]:
    """The dictionary of each family that holds all markers of the others."""
    families = {_family(name): name for name in sorted(_COUNTS, key=lambda name: _COUNTS[name])}
    return [name for name in DICTIONARIES if name in families.values()]


def smallest_dictionary(family_member: str, last: int, *, like: str) -> str | None:
    """The smallest dictionary of a family that holds the markers up to a number; None if none.

    like : a dictionary, of whose size it is where that suffices.
    """
    family = _family(family_member)
    names = [name for name in DICTIONARIES if _family(name) == family and _COUNTS[name] > last]
    names.sort(key=lambda name: (_COUNTS[name] != _COUNTS[like], _COUNTS[name]))
    return names[0] if names else None


def _family(dictionary: str) -> str:
    """What ArUco's dictionaries of one size have in common, which begin alike."""
    size, count = dictionary.split("_")
    return size if count.isdigit() else dictionary


def opencv_dictionary(name: str) -> Any:
    """The `cv2.aruco.Dictionary` of one of `DICTIONARIES`."""
    import cv2

    own, count = name.split("_")
    return cv2.aruco.getPredefinedDictionary(
        getattr(cv2.aruco, f"DICT_{own.replace('x', 'X')}_{count}")
    )


def marker_cells(dictionary: Any, number: int, *, border: int) -> Bool[np.ndarray, "k k"]:
    """Which cells of a marker are ink, its border of so many cells included, the top row first."""
    import cv2

    cells = dictionary.markerSize + 2 * border
    picture = np.asarray(
        cv2.aruco.generateImageMarker(dictionary, number, cells * _CELL_PX, borderBits=border)
    )
    return picture[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX] < 128
