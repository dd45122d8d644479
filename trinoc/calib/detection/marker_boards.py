"""The corners of boards with markers: of a ChArUco board by OpenCV, of a grid of AprilTags by ours.

Source: S. Garrido-Jurado et al., "Automatic generation and detection of highly reliable fiducial
markers under occlusion", Pattern Recognition 47(6), 2014 (`cv2.aruco.CharucoDetector`).
"""

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from trinoc.calib.detection.corners import corner_covariance_px2, levels_of_8_bit
from trinoc.calib.detection.detection import Detection, labelled_detection
from trinoc.calib.detection.search_image import search_image
from trinoc.calib.detection.tag_reading import read_tags
from trinoc.calib.targets import (
    AprilGrid,
    Charuco,
    opencv_board,
    opencv_dictionary,
)
from trinoc.errors import DetectionError

_FEWEST_CORNERS = 6
_FEWEST_TAGS = 2
# Half the width of the window for a corner, over that of the gap, so that no other edge is in it.
_WINDOW_SHARE = 0.45
_SMALLEST_HALF_PX, _LARGEST_HALF_PX = 2, 11
# A corner that moves by more of its gap is another one.
_MOST_MOVED = 0.5
# How far from a corner its four fields are looked at, over the gap, and by how much, over the
# contrast, two fields of one ink may differ: more where something covers one.
_LOOK, _ALIKE = 0.3, 0.35
# A tag that is not where the others have it, by this share of its side, was read wrongly.
_MOST_OFF = 0.25

# (numbers (k,), places (k, ...)) of what is found in grey levels.
_Find = Callable[[UInt8[np.ndarray, "h w"]], tuple[np.ndarray, np.ndarray]]


def detect_charuco(image: Shaped[np.ndarray, "..."], board: Charuco) -> Detection:
    """The corners of a ChArUco board that the picture shows, whole or in part.

    Raises DetectionError where no such board is seen, or too little of it, or its mirror image.
    """
    picture = search_image(image)
    detector = cv2.aruco.CharucoDetector(opencv_board(board))

    def find(grey: UInt8[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
        corners, index, _, _ = detector.detectBoard(grey)
        if corners is None or index is None:
            return np.zeros(0, dtype=int), np.zeros((0, 2))
        return np.ravel(index).astype(int), np.asarray(corners, dtype=np.float64).reshape(-1, 2)

    grey, wanted = levels_of_8_bit(picture.grey), f"corners of the board {board.name!r}"
    index, corners_px = _find_enough(find, grey, wanted, _FEWEST_CORNERS, "dictionary")
    order = np.argsort(index)
    index, corners_px = index[order], corners_px[order]
    covariance_px2 = corner_covariance_px2(picture, corners_px)
    return labelled_detection(index[None], corners_px, covariance_px2, picture.size_px)


def detect_april_grid(image: Shaped[np.ndarray, "..."], board: AprilGrid) -> Detection:
    """The corners of the tags that the picture shows, all of them or some.

    Raises DetectionError where no such board is seen, or too little of it, or its mirror image.
    """
    picture = search_image(image)
    grey, wanted = levels_of_8_bit(picture.grey), f"tags of the board {board.name!r}"
    find, layout = partial(_find_tags, board=board), "dictionary, border"
    tags, corners_px = _find_enough(find, grey, wanted, _FEWEST_TAGS, layout)
    index = (4 * tags[:, None] + np.arange(4)).ravel()
    places, is_sharp = _refine_corners(grey, corners_px, board.spacing)
    index, places = index[is_sharp], places[is_sharp]
    covariance_px2 = corner_covariance_px2(picture, places)
    return labelled_detection(index[None], places, covariance_px2, picture.size_px)


def _find_enough(
    find: _Find, grey: UInt8[np.ndarray, "h w"], wanted: str, fewest: int, layout: str
) -> tuple[np.ndarray, np.ndarray]:
    """What `find` finds. Raises DetectionError where that is too little, or more in a mirror."""
    numbers, places = find(grey)
    if len(numbers) >= fewest:
        return numbers, places
    if len(find(np.ascontiguousarray(grey[:, ::-1]))[0]) >= fewest:
        raise DetectionError(
            f"The picture shows {wanted.partition(' of ')[2]} as in a mirror; flip the picture, or "
            "see how the camera's driver delivers it."
        )
    raise DetectionError(
        f"The picture shows {len(numbers)} {wanted}, but {fewest} are needed; see that {layout}, "
        "size and focus are right."
    )


def _find_tags(
    grey: UInt8[np.ndarray, "h w"], board: AprilGrid
) -> tuple[Int[np.ndarray, "t"], Float[np.ndarray, "t 4 2"]]:
    """(which tags, their corners from the board's lower left counter-clockwise), by number."""
    seen = read_tags(grey, opencv_dictionary(board.dictionary), board.border)
    last = board.first + board.rows * board.columns
    own = {number: corners for number, corners in seen.items() if board.first <= number < last}
    if len(own) < _FEWEST_TAGS:
        return np.zeros(0, dtype=int), np.zeros((0, 4, 2))
    tags = np.array(sorted(own))
    return _tags_in_place(tags - board.first, np.stack([own[number] for number in tags]), board)


def _tags_in_place(
    tags: Int[np.ndarray, "t"], corners_px: Float[np.ndarray, "t 4 2"], board: AprilGrid
) -> tuple[Int[np.ndarray, "t"], Float[np.ndarray, "t 4 2"]]:
    """Tags that lie as the board has them, with corners in the board's order.

    Programs print tags turned by quarters: all of a board are turned alike, and the turn that puts
    most of them in place is theirs.
    """
    places = board.centres_mm.reshape(-1, 4, 2)[tags]
    # OpenCV goes round clockwise in the picture, the board's order counter-clockwise.
    turned = [corners_px[:, np.roll([3, 2, 1, 0], quarters)] for quarters in range(4)]
    off = [_distances_in_sides(places, corners) for corners in turned]
    best = int(np.argmin([np.median(each) for each in off]))
    kept = off[best] < _MOST_OFF
    return tags[kept], turned[best][kept]


def _distances_in_sides(
    places_mm: Float[np.ndarray, "t 4 2"], corners_px: Float[np.ndarray, "t 4 2"]
) -> Float[np.ndarray, "t"]:
    """How far each tag lies from where most of them have it, in sides of its own."""
    flat = places_mm.reshape(-1, 1, 2)
    homography, _ = cv2.findHomography(flat, corners_px.reshape(-1, 1, 2), cv2.LMEDS)
    if homography is None:
        return np.full(len(places_mm), np.inf)
    ideal = cv2.perspectiveTransform(flat, homography).reshape(-1, 4, 2)
    side = np.linalg.norm(ideal - np.roll(ideal, 1, axis=1), axis=2).mean(axis=1)
    return np.linalg.norm(ideal - corners_px, axis=2).max(axis=1) / np.maximum(side, 1e-9)


def _refine_corners(
    grey: UInt8[np.ndarray, "h w"], corners_px: Float[np.ndarray, "t 4 2"], spacing: float
) -> tuple[Float[np.ndarray, "n 2"], np.ndarray]:
    """(places, which of them the picture shows as corners between dark squares)."""
    side = np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=1), axis=2).min(axis=1)
    gap = spacing * side
    half = int(np.clip(_WINDOW_SHARE * np.median(gap), _SMALLEST_HALF_PX, _LARGEST_HALF_PX))
    start = corners_px.reshape(-1, 2)
    places = cv2.cornerSubPix(
        grey,
        start.astype(np.float32).reshape(-1, 1, 2),
        (half, half),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3),
    ).reshape(-1, 2)
    moved = np.linalg.norm(places - start, axis=1)
    sharp = moved < np.maximum(_MOST_MOVED * np.repeat(gap, 4), 1.5)
    return places.astype(np.float64), sharp & _is_saddle(grey, corners_px, places, spacing)


def _is_saddle(
    grey: UInt8[np.ndarray, "h w"],
    corners_px: Float[np.ndarray, "t 4 2"],
    places: Float[np.ndarray, "n 2"],
    spacing: float,
) -> Bool[np.ndarray, "n"]:
    """Whether the tag and the square opposite are alike dark, and both gaps alike light."""
    reach = _LOOK * spacing
    one = reach * (np.roll(corners_px, -1, axis=1) - corners_px).reshape(-1, 2)
    other = reach * (np.roll(corners_px, 1, axis=1) - corners_px).reshape(-1, 2)
    ways = np.stack([one + other, -one - other, one - other, other - one])
    at = (places + ways).astype(np.float32)
    border = cv2.BORDER_REPLICATE
    levels = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=border)
    dark, light = levels.astype(np.float64).reshape(2, 2, -1)
    contrast = light.mean(axis=0) - dark.mean(axis=0)
    unlike = np.maximum(np.ptp(dark, axis=0), np.ptp(light, axis=0))
    return (contrast > 0) & (unlike < _ALIKE * contrast)
