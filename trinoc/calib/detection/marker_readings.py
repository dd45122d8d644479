"""Boards with markers that are almost the stated one: which other layout an image shows.

Markers identify themselves, so that an image without the stated board may still tell which board it
shows. The likeliest slips are tried in order: the other pattern of OpenCV's versions, rows and
columns exchanged, white printed for black, the image of a mirror, two of these together, another
first marker, another dictionary. A layout is named only where markers lie as in it and its corners
are then found.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8

from trinoc.calib.detection.corners import levels_of_8_bit
from trinoc.calib.detection.marker_boards import (
    as_plain_print,
    corners_by_number,
    count_beside_neighbours,
    detect_april_grid,
    detect_charuco,
    list_figures,
    read_tags,
    tags_in_place,
)
from trinoc.calib.detection.search_image import search_image
from trinoc.calib.detection.usable_places import keep_usable
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.board_set import list_boards
from trinoc.calib.targets.checkers import Charuco
from trinoc.calib.targets.markers import (
    list_largest_dictionaries,
    opencv_dictionary,
    smallest_dictionary,
)
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import DetectionError

# numerical: markers that must lie as in another layout, or all of a smaller board.
_FEWEST_IN_PLACE = 4
# numerical: quadrangles that are read by every dictionary before all are, for time.
_MOST_FIGURES = 60
# numerical: images of a camera in which all readings are tried: the board may be absent in some.
MOST_IMAGES = 4

_MarkerBoard = Charuco | AprilGrid
# Corners of each marker by number, from its own top left clockwise.
_Markers = Mapping[int, Float[np.ndarray, "4 2"]]


class MarkerReading(NamedTuple):
    """The board that an image shows in place of the stated one.

    Fields
    ------
    board : its layout.
    changes : how it differs from the stated layout, such as "legacy=yes".
    count : number of its markers that the image shows where this layout has them.
    is_in_mirror : whether the image shows it as in a mirror, or the stated board is a mirrored one
        and the image shows the plain print.
    is_same_sheet : whether it may be the stated sheet, described wrongly: its markers are the same.
    """

    board: _MarkerBoard
    changes: tuple[str, ...]
    count: int
    is_in_mirror: bool = False
    is_same_sheet: bool = False

    @property
    def sentence(self) -> str:
        """What the image shows, and what to do."""
        things = "tags" if isinstance(self.board, AprilGrid) else "markers"
        what = f"{self.count} {things} of {self.board.dictionary} are visible"
        named = f"the board {self.board.name!r} fits with {' and '.join(self.changes)}"
        if not self.is_in_mirror:
            return f"{what}; {named}: correct its layout."
        what += " as in a mirror"
        if isinstance(self.board, AprilGrid):
            return (
                f"{what}: see how the driver of the camera delivers its pictures, or print the "
                f"board {self.board.name!r} again."
            )
        if not self.board.mirrored:
            return f"{what} of the stated board; {named}: correct its layout."
        return (
            f"{what}; {named}: state this for a mirrored print, such as the back of a two-sided "
            "board, which is a second board of a set; otherwise see how the driver of the camera "
            "delivers its pictures."
        )


class ReadingSearch:
    """Other readings of the boards of a target, in the images of a recording.

    All readings are tried in few images of each camera; those that fit one are then tried alone.
    """

    def __init__(
        self,
        target: AbstractTarget,
        *,
        most_images: int = MOST_IMAGES,
        tuning: CalibTuning = TUNING,
    ) -> None:
        boards = list_boards(target)
        self._boards = [board for board in boards if isinstance(board, Charuco | AprilGrid)]
        self._readings: list[MarkerReading] = []
        self._images, self._most_images = Counter[str](), most_images
        self._tuning = tuning

    def is_over(self, camera: str) -> bool:
        """Whether no more images of a camera will be explained."""
        is_exhausted = self._images[camera] >= self._most_images
        return not self._boards or (is_exhausted and not self._readings)

    def find(self, image: Shaped[np.ndarray, "..."], camera: str = "") -> MarkerReading | None:
        """The board that an image shows in place of a stated one; None if none is known."""
        for reading in self._readings:
            count = _count_markers(image, reading, self._tuning)
            if count:
                return reading._replace(count=count)
        if self._images[camera] >= self._most_images:
            return None
        self._images[camera] += 1
        for board in self._boards:
            reading = find_marker_reading(image, board, self._tuning)
            if reading is not None:
                self._readings.append(reading)
                return reading
        return None


def find_marker_reading(
    image: Shaped[np.ndarray, "..."], board: _MarkerBoard, tuning: CalibTuning
) -> MarkerReading | None:
    """The layout that an image shows in place of `board`, which was not found in it; None if none.

    Markers are searched in the image some ten times.
    """
    grey = levels_of_8_bit(search_image(image).grey)
    readings = (
        _read_charuco(grey, board, tuning)
        if isinstance(board, Charuco)
        else _read_april_grid(grey, board, tuning)
    )
    return next((reading for reading in readings if _shows_corners(image, reading, tuning)), None)


def _count_markers(
    image: Shaped[np.ndarray, "..."], reading: MarkerReading, tuning: CalibTuning
) -> int:
    """How many markers of a board an image shows in place; 0 where they are too few to tell."""
    grey, board = levels_of_8_bit(search_image(image).grey), reading.board
    dictionary = opencv_dictionary(board.dictionary)
    if isinstance(board, Charuco):
        return _count_in_place(_find_markers(grey, board, dictionary), board, tuning)
    plain = as_plain_print(grey, inverted=False, mirrored=reading.is_in_mirror)
    figures = list_figures(plain, dictionary, board.border, tuning)
    return _count_in_place(read_tags(figures, dictionary, board.border, tuning), board, tuning)


def _shows_corners(
    image: Shaped[np.ndarray, "..."], reading: MarkerReading, tuning: CalibTuning
) -> bool:
    """Whether the corners of this board are found in an image."""
    board, image = reading.board, np.asarray(image)
    try:
        if isinstance(board, Charuco):
            keep_usable(detect_charuco(image, board, tuning), board, tuning)
        else:
            seen = np.ascontiguousarray(image[:, ::-1]) if reading.is_in_mirror else image
            keep_usable(detect_april_grid(seen, board, tuning), board, tuning)
    except DetectionError:
        return False
    return True


def _read_charuco(
    grey: UInt8[np.ndarray, "h w"], stated: Charuco, tuning: CalibTuning
) -> Iterator[MarkerReading]:
    """Other layouts in which markers are in place, the likeliest first."""
    dictionary, stated_markers = opencv_dictionary(stated.dictionary), {}
    for looks in ((), ("inverted",), ("mirrored",), ("inverted", "mirrored")):
        looking = replace(stated, **{look: not getattr(stated, look) for look in looks})
        markers = _find_markers(grey, looking, dictionary)
        changes, board, count = _best_layout(markers, looking, tuning, most_changes=2 - len(looks))
        if not looks:
            stated_markers = markers
            for other in _read_other_first(markers, stated, tuning):
                if other.count > count:
                    yield other
                    count = 0
            if count and not changes:
                # The stated layout is right, and too little of the board is visible.
                return
        if count:
            yield MarkerReading(
                board,
                (*(_describe(board, look) for look in looks), *changes),
                count,
                is_in_mirror="mirrored" in looks,
                is_same_sheet="mirrored" not in looks,
            )
    if len(stated_markers) >= _FEWEST_IN_PLACE:
        return
    for name in list_largest_dictionaries():
        if name != stated.dictionary:
            markers = _find_markers(grey, stated, opencv_dictionary(name))
            yield from _read_other_dictionary(markers, stated, name, tuning)


def _read_april_grid(
    grey: UInt8[np.ndarray, "h w"], stated: AprilGrid, tuning: CalibTuning
) -> Iterator[MarkerReading]:
    """Other layouts in which tags are in place, the likeliest first."""
    dictionary = opencv_dictionary(stated.dictionary)
    figures = list_figures(grey, dictionary, stated.border, tuning)
    tags = read_tags(figures, dictionary, stated.border, tuning)
    stated_count, others = _count_in_place(tags, stated, tuning), []
    exchanged = replace(stated, rows=stated.columns, columns=stated.rows)
    if count := _count_in_place(tags, exchanged, tuning):
        others.append(MarkerReading(exchanged, (_describe(exchanged, "exchanged"),), count))
    others += _read_other_first(tags, stated, tuning)
    yield from (other for other in others if other.count > stated_count)
    if stated_count:
        return
    flipped = as_plain_print(grey, inverted=False, mirrored=True)
    in_mirror = read_tags(
        list_figures(flipped, dictionary, stated.border, tuning), dictionary, stated.border, tuning
    )
    if count := _count_in_place(in_mirror, stated, tuning):
        yield MarkerReading(stated, (), count, is_in_mirror=True)
    largest = sorted(figures, key=lambda figure: figure.side_px)[-_MOST_FIGURES:]
    fewest = min(_FEWEST_IN_PLACE, len(stated.numbers))
    for border in (stated.border, 3 - stated.border):
        other = replace(stated, border=border)
        for name in list_largest_dictionaries():
            dictionary = opencv_dictionary(name)
            if len(read_tags(largest, dictionary, border, tuning)) < fewest:
                continue
            tags = read_tags(figures, dictionary, border, tuning)
            if border != stated.border and name == stated.dictionary:
                if count := _count_in_place(tags, other, tuning):
                    yield MarkerReading(other, (f"border={border}",), count)
            elif name != stated.dictionary:
                for reading in _read_other_dictionary(tags, other, name, tuning):
                    changes = reading.changes
                    if border != stated.border:
                        changes = (*changes, f"border={border}")
                    yield reading._replace(changes=changes)


def _read_other_dictionary(
    markers: _Markers, stated: _MarkerBoard, name: str, tuning: CalibTuning
) -> Iterator[MarkerReading]:
    """The board with markers of another dictionary, and if need be of other numbers."""
    changes, board, count = (), stated, _count_in_place(markers, stated, tuning)
    if isinstance(stated, Charuco):
        changes, board, count = _best_layout(markers, stated, tuning, most_changes=1)
    held = smallest_dictionary(name, stated.numbers[-1], like=stated.dictionary)
    if count and held is not None and held != stated.dictionary:
        board = replace(board, dictionary=held)
        yield MarkerReading(board, (f"dictionary={held}", *changes), count)
    if not count:
        yield from _read_other_first(markers, stated, tuning, name)


def _read_other_first(
    markers: _Markers, stated: _MarkerBoard, tuning: CalibTuning, name: str | None = None
) -> Iterator[MarkerReading]:
    """The board with the first marker with which most of these are in place, if it is only one.

    name : of the dictionary, or of a larger one of its family; the stated one unless given.
    """
    if len(markers) < _FEWEST_IN_PLACE:
        return
    size, numbers = len(stated.numbers), np.array(list(markers))
    # Not all markers need belong to the board: one of another sheet must not narrow the search.
    firsts = [
        first
        for first in range(max(int(numbers.min()) - size + 1, 0), int(numbers.max()) + 1)
        if first != stated.first
        and np.sum((numbers >= first) & (numbers < first + size)) >= _FEWEST_IN_PLACE
    ]
    counts = [
        _count_in_place(_renumber(markers, stated.first - first), stated, tuning)
        for first in firsts
    ]
    best = max(counts, default=0)
    if not best or counts.count(best) > 1:
        return
    first = firsts[counts.index(best)]
    like = stated.dictionary
    held = smallest_dictionary(name or like, first + size - 1, like=like)
    if held is None or (name is None and held != like):
        return
    other = [] if held == like else [f"dictionary={held}"]
    board = replace(stated, dictionary=held, first=first)
    yield MarkerReading(board, (*other, f"first={first}"), best)


def _renumber(markers: _Markers, step: int) -> _Markers:
    return {number + step: corners for number, corners in markers.items()}


def _best_layout(
    markers: _Markers, board: Charuco, tuning: CalibTuning, *, most_changes: int
) -> tuple[tuple[str, ...], Charuco, int]:
    """(changes, board, markers in place) of the layout in which most markers are in place.

    A layout with fewer changes is preferred.
    """
    changes, layout, count = (), board, _count_in_place(markers, board, tuning)
    for number in range(1, most_changes + 1):
        for changed in combinations(("legacy", "exchanged"), number):
            other = board
            if "exchanged" in changed:
                other = replace(other, rows=board.columns, columns=board.rows)
            if "legacy" in changed:
                other = replace(other, legacy=not board.legacy)
            other_count = _count_in_place(markers, other, tuning)
            if other_count > count:
                layout, count = other, other_count
                changes = tuple(_describe(other, each) for each in changed)
    return changes, layout, count


def _describe(board: _MarkerBoard, changed: str) -> str:
    if changed == "exchanged":
        return f"rows and columns exchanged (rows={board.rows} columns={board.columns})"
    return f"{changed}={'yes' if getattr(board, changed) else 'no'}"


def _find_markers(
    grey: UInt8[np.ndarray, "h w"], board: Charuco, dictionary: cv2.aruco.Dictionary
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Markers in the picture in which the board looks as its plain print does."""
    plain = as_plain_print(grey, inverted=board.inverted, mirrored=board.mirrored)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(plain)
    return corners_by_number(corners, numbers)


def _count_in_place(markers: _Markers, board: _MarkerBoard, tuning: CalibTuning) -> int:
    """How many markers lie as in a board; 0 where they are too few to tell.

    Markers of a ChArUco board are those of `_find_markers`, which finds the plain print.
    """
    if isinstance(board, AprilGrid):
        count = len(tags_in_place(markers, board, tuning)[0])
    else:
        count = count_beside_neighbours(markers, board)
    return count if count >= min(_FEWEST_IN_PLACE, len(board.numbers)) else 0
