"""Diagnosis of a wrong layout: the board with markers that an image shows instead.

Markers have ids. An image without the stated board can therefore show which board it contains.
The most likely mistakes are tried in this order: layout of the other OpenCV version, rows and
columns exchanged, inverted print, mirrored print, two of these together, another first marker,
another dictionary. A layout is reported only if its markers are in place and its corners are
detected.
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
    corners_by_id,
    count_markers_in_place,
    detect_april_grid,
    detect_charuco,
    list_quadrangles,
    read_tags,
    select_tags_in_place,
    undo_print_options,
)
from trinoc.calib.detection.search_image import search_image
from trinoc.calib.detection.usable_points import remove_unusable
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

# numerical: fewest markers in place in another layout; a smaller board needs all of its markers.
_FEWEST_IN_PLACE = 4
# numerical: number of quadrangles read with every dictionary first, to save time.
_MOST_QUADRANGLES = 60
# numerical: images per camera in which all layouts are tried; in some the board may be absent.
MOST_IMAGES = 4

_MarkerBoard = Charuco | AprilGrid
# Corners of each marker by its id, from its top left clockwise.
_Markers = Mapping[int, Float[np.ndarray, "4 2"]]


class MarkerReading(NamedTuple):
    """Layout of the board that an image shows, with its differences from the stated layout.

    Attributes
    ----------
    board : layout of the visible board.
    changes : differences from the stated layout, such as "legacy=yes".
    count : number of visible markers that agree with this layout.
    is_in_mirror : True if the visible board is the mirror image of the stated board.
    is_same_sheet : True if the markers are those of the stated board. The stated layout may then be
        a wrong description of the same sheet.
    """

    board: _MarkerBoard
    changes: tuple[str, ...]
    count: int
    is_in_mirror: bool = False
    is_same_sheet: bool = False

    @property
    def sentence(self) -> str:
        """Message that describes the visible board, with a remedy."""
        things = "tags" if isinstance(self.board, AprilGrid) else "markers"
        what = f"{self.count} {things} of {self.board.dictionary} are visible"
        fit = f"the board {self.board.name!r} fits with {' and '.join(self.changes)}"
        if not self.is_in_mirror:
            return f"{what}; {fit}: correct its layout."
        what += " as in a mirror"
        if isinstance(self.board, AprilGrid):
            return (
                f"{what}: check whether the camera's driver mirrors its images, or print the "
                f"board {self.board.name!r} again."
            )
        if not self.board.mirrored:
            return f"{what} of the stated board; {fit}: correct its layout."
        return (
            f"{what}; {fit}: state this in the layout if the print is mirrored, such as the back "
            "of a two-sided board, which is a second board of a set; otherwise check whether the "
            "camera's driver mirrors its images."
        )


class ReadingSearch:
    """Search for wrongly stated board layouts in the images of a recording.

    All layouts are tried in a few images of each camera. Later images are tested only with the
    layouts that agreed with an earlier image.

    Parameters
    ----------
    target : the stated board or set of boards.
    most_images : number of images per camera in which all layouts are tried.
    tuning : tuned constants of calibration.
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
        """True if `find` returns None for all further images of a camera."""
        is_exhausted = self._images[camera] >= self._most_images
        return not self._boards or (is_exhausted and not self._readings)

    def find(self, image: Shaped[np.ndarray, "..."], camera: str = "") -> MarkerReading | None:
        """Find the layout of a visible board that was not detected with its stated layout.

        Parameters
        ----------
        image : image without a detected board.
        camera : name of the camera.

        Returns
        -------
        Board with its true layout; None if no layout agrees with the image.
        """
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
    """Find the layout of a visible board that was not detected with its stated layout.

    The function searches the image for markers about ten times.

    Parameters
    ----------
    image : image in which `board` was not detected.
    board : the stated board.
    tuning : tuned constants of calibration.

    Returns
    -------
    Board with its true layout; None if no layout agrees with the image.
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
    """Number of markers in an image that agree with a layout; 0 if they are too few."""
    grey, board = levels_of_8_bit(search_image(image).grey), reading.board
    dictionary = opencv_dictionary(board.dictionary)
    if isinstance(board, Charuco):
        return _count_consistent_markers(_find_markers(grey, board, dictionary), board, tuning)
    plain = undo_print_options(grey, inverted=False, mirrored=reading.is_in_mirror)
    quadrangles = list_quadrangles(plain, dictionary, board.border, tuning)
    return _count_consistent_markers(
        read_tags(quadrangles, dictionary, board.border, tuning), board, tuning
    )


def _shows_corners(
    image: Shaped[np.ndarray, "..."], reading: MarkerReading, tuning: CalibTuning
) -> bool:
    """True if the corners of the board are detected in an image."""
    board, image = reading.board, np.asarray(image)
    try:
        if isinstance(board, Charuco):
            remove_unusable(detect_charuco(image, board, tuning), board, tuning)
        else:
            upright = np.ascontiguousarray(image[:, ::-1]) if reading.is_in_mirror else image
            remove_unusable(detect_april_grid(upright, board, tuning), board, tuning)
    except DetectionError:
        return False
    return True


def _read_charuco(
    grey: UInt8[np.ndarray, "h w"], stated: Charuco, tuning: CalibTuning
) -> Iterator[MarkerReading]:
    """Yield other layouts that agree with the markers of an image, the most likely layout first.

    stated : the stated board.
    """
    dictionary, stated_markers = opencv_dictionary(stated.dictionary), {}
    for prints in ((), ("inverted",), ("mirrored",), ("inverted", "mirrored")):
        variant = replace(stated, **{field: not getattr(stated, field) for field in prints})
        markers = _find_markers(grey, variant, dictionary)
        changes, board, count = _best_layout(markers, variant, tuning, most_changes=2 - len(prints))
        if not prints:
            stated_markers = markers
            for other in _read_other_first(markers, stated, tuning):
                if other.count > count:
                    yield other
                    count = 0
            if count and not changes:
                # The stated layout is right, but too little of the board is visible.
                return
        if count:
            yield MarkerReading(
                board,
                (*(_describe(board, field) for field in prints), *changes),
                count,
                is_in_mirror="mirrored" in prints,
                is_same_sheet="mirrored" not in prints,
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
    """Yield other layouts that agree with the tags of an image, the most likely layout first.

    stated : the stated board.
    """
    dictionary = opencv_dictionary(stated.dictionary)
    quadrangles = list_quadrangles(grey, dictionary, stated.border, tuning)
    tags = read_tags(quadrangles, dictionary, stated.border, tuning)
    stated_count, others = _count_consistent_markers(tags, stated, tuning), []
    exchanged = replace(stated, rows=stated.columns, columns=stated.rows)
    if count := _count_consistent_markers(tags, exchanged, tuning):
        others.append(MarkerReading(exchanged, (_describe(exchanged, "exchanged"),), count))
    others += _read_other_first(tags, stated, tuning)
    yield from (other for other in others if other.count > stated_count)
    if stated_count:
        return
    flipped = undo_print_options(grey, inverted=False, mirrored=True)
    flipped_quadrangles = list_quadrangles(flipped, dictionary, stated.border, tuning)
    flipped_tags = read_tags(flipped_quadrangles, dictionary, stated.border, tuning)
    if count := _count_consistent_markers(flipped_tags, stated, tuning):
        yield MarkerReading(stated, (), count, is_in_mirror=True)
    by_size = sorted(quadrangles, key=lambda quadrangle: quadrangle.side_px)
    largest = by_size[-_MOST_QUADRANGLES:]
    fewest = min(_FEWEST_IN_PLACE, len(stated.marker_ids))
    for border in (stated.border, 3 - stated.border):
        other = replace(stated, border=border)
        for name in list_largest_dictionaries():
            dictionary = opencv_dictionary(name)
            if len(read_tags(largest, dictionary, border, tuning)) < fewest:
                continue
            tags = read_tags(quadrangles, dictionary, border, tuning)
            if border != stated.border and name == stated.dictionary:
                if count := _count_consistent_markers(tags, other, tuning):
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
    """Yield the stated board with another dictionary, and with other marker ids if necessary.

    name : a dictionary that contains all visible markers.
    """
    changes, board, count = (), stated, _count_consistent_markers(markers, stated, tuning)
    if isinstance(stated, Charuco):
        changes, board, count = _best_layout(markers, stated, tuning, most_changes=1)
    smallest = smallest_dictionary(name, stated.marker_ids[-1], like=stated.dictionary)
    if count and smallest is not None and smallest != stated.dictionary:
        board = replace(board, dictionary=smallest)
        yield MarkerReading(board, (f"dictionary={smallest}", *changes), count)
    if not count:
        yield from _read_other_first(markers, stated, tuning, name)


def _read_other_first(
    markers: _Markers, stated: _MarkerBoard, tuning: CalibTuning, name: str | None = None
) -> Iterator[MarkerReading]:
    """Yield the stated board with another id of its first marker.

    The id must agree with more markers than every other id.

    name : dictionary of the markers, or a larger dictionary of the same family; the stated
        dictionary if None.
    """
    if len(markers) < _FEWEST_IN_PLACE:
        return
    size, ids = len(stated.marker_ids), np.array(list(markers))
    # Some markers may belong to another sheet: they must not restrict the search.
    firsts = [
        first
        for first in range(max(int(ids.min()) - size + 1, 0), int(ids.max()) + 1)
        if first != stated.first
        and np.sum((ids >= first) & (ids < first + size)) >= _FEWEST_IN_PLACE
    ]
    counts = [
        _count_consistent_markers(_renumber(markers, stated.first - first), stated, tuning)
        for first in firsts
    ]
    best = max(counts, default=0)
    if not best or counts.count(best) > 1:
        return
    first = firsts[counts.index(best)]
    like = stated.dictionary
    smallest = smallest_dictionary(name or like, first + size - 1, like=like)
    if smallest is None or (name is None and smallest != like):
        return
    changes = [] if smallest == like else [f"dictionary={smallest}"]
    board = replace(stated, dictionary=smallest, first=first)
    yield MarkerReading(board, (*changes, f"first={first}"), best)


def _renumber(markers: _Markers, step: int) -> _Markers:
    return {marker_id + step: corners for marker_id, corners in markers.items()}


def _best_layout(
    markers: _Markers, board: Charuco, tuning: CalibTuning, *, most_changes: int
) -> tuple[tuple[str, ...], Charuco, int]:
    """Find the variant of a board's layout that agrees with the most markers.

    The variants are the board itself, the opposite value of `legacy`, and exchanged rows and
    columns. With equal numbers of markers, the variant with fewer changes is preferred.

    markers : corners of each marker by its id, from `_find_markers`.
    most_changes : largest number of changes in one variant: 1, or 2 to try both changes together.

    Returns
    -------
    Descriptions of the changes, the board with these changes, and the number of markers that agree
    with it.
    """
    changes, layout, count = (), board, _count_consistent_markers(markers, board, tuning)
    for change_count in range(1, most_changes + 1):
        for changed in combinations(("legacy", "exchanged"), change_count):
            other = board
            if "exchanged" in changed:
                other = replace(other, rows=board.columns, columns=board.rows)
            if "legacy" in changed:
                other = replace(other, legacy=not board.legacy)
            other_count = _count_consistent_markers(markers, other, tuning)
            if other_count > count:
                layout, count = other, other_count
                changes = tuple(_describe(other, change) for change in changed)
    return changes, layout, count


def _describe(board: _MarkerBoard, changed: str) -> str:
    if changed == "exchanged":
        return f"rows and columns exchanged (rows={board.rows} columns={board.columns})"
    return f"{changed}={'yes' if getattr(board, changed) else 'no'}"


def _find_markers(
    grey: UInt8[np.ndarray, "h w"], board: Charuco, dictionary: cv2.aruco.Dictionary
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Corners of each visible marker by its id, after the print options of the board are undone."""
    plain = undo_print_options(grey, inverted=board.inverted, mirrored=board.mirrored)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(plain)
    return corners_by_id(corners, ids)


def _count_consistent_markers(markers: _Markers, board: _MarkerBoard, tuning: CalibTuning) -> int:
    """Number of markers that agree with a layout; 0 if they are too few.

    markers : corners of each marker by its id; for a ChArUco board, the result of `_find_markers`.
    """
    if isinstance(board, AprilGrid):
        count = len(select_tags_in_place(markers, board, tuning)[0])
    else:
        count = count_markers_in_place(markers, board)
    return count if count >= min(_FEWEST_IN_PLACE, len(board.marker_ids)) else 0
