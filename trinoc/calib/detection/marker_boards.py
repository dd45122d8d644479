"""The corners of boards with markers: of a ChArUco board by OpenCV, of a grid of AprilTags by ours.

Source: S. Garrido-Jurado et al., "Automatic generation and detection of highly reliable fiducial
markers under occlusion", Pattern Recognition 47(6), 2014 (`cv2.aruco.CharucoDetector`).
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from trinoc.calib.detection.corner_fit import FittedCorners
from trinoc.calib.detection.corners import distances_to_next, levels_of_8_bit, refine_corners
from trinoc.calib.detection.detection import Detection, build_detection
from trinoc.calib.detection.search_image import SearchImage, search_image
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Charuco, opencv_board
from trinoc.calib.targets.markers import opencv_dictionary
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.errors import DetectionError
from trinoc.numerics.joins import point_tree

# numerical: neighbours of a marker whose positions it predicts, and how far the median one may be
# off, over the distance between both: a wrong layout misses by about that distance.
_NEIGHBOURS, _MOST_OFF = 3, 0.3
# numerical: so many more markers must be in place with the other pattern of OpenCV's versions.
_MORE_IN_PLACE = 2
# numerical: pixels of a cell that is read, and those of its rim, where cells blur into each other.
_CELL_PX, _RIM_PX = 8, 2


def detect_charuco(
    image: Shaped[np.ndarray, "..."], board: Charuco, tuning: CalibTuning
) -> Detection:
    """The corners of a ChArUco board that the picture shows, whole or in part.

    Raises DetectionError where the picture shows no such board, or too little of it.
    """
    picture = search_image(image)
    grey, fewest = levels_of_8_bit(picture.grey), tuning.detection.fewest_places
    detector = cv2.aruco.CharucoDetector(opencv_board(board))
    plain = as_plain_print(grey, inverted=board.inverted, mirrored=board.mirrored)
    corners, index, marker_corners, numbers = detector.detectBoard(plain)
    count = 0 if index is None else len(index)
    if corners is None or index is None or count < fewest:
        raise DetectionError(
            f"The picture shows {count} corners of the board {board.name!r}, but {fewest} are "
            f"needed; {_describe_markers(board, numbers)}."
        )
    _expect_pattern(board, corners_by_number(marker_corners, numbers))
    order = np.argsort(np.ravel(index))
    index = np.ravel(index)[order].astype(int)
    corners_px = np.asarray(corners, dtype=np.float64).reshape(-1, 2)[order]
    if board.mirrored:
        corners_px[:, 0] = grey.shape[1] - 1 - corners_px[:, 0]
    # OpenCV 4 puts them half a pixel aside: they are found again, in what markers leave of room.
    room = distances_to_next(corners_px) * (1 - board.marker_mm / board.square_mm)
    fitted = refine_corners(picture, grey, corners_px, room, tuning)
    return build_detection(index[None], *fitted, picture.size_px)


def detect_april_grid(
    image: Shaped[np.ndarray, "..."], board: AprilGrid, tuning: CalibTuning
) -> Detection:
    """The corners of the tags that the picture shows, all of them or some.

    Raises DetectionError where the picture shows no such board, or too little of it.
    """
    picture = search_image(image)
    grey = levels_of_8_bit(picture.grey)
    dictionary = opencv_dictionary(board.dictionary)
    figures = list_figures(grey, dictionary, board.border, tuning)
    seen = read_tags(figures, dictionary, board.border, tuning)
    tags, corners_px = tags_in_place(seen, board, tuning)
    fewest = tuning.detection.fewest_tags
    if len(tags) < fewest:
        raise DetectionError(
            f"The picture shows {len(tags)} tags of the board {board.name!r}, but {fewest} "
            f"are needed; {_describe_tags(board, seen)}."
        )
    index = (4 * tags[:, None] + np.arange(4)).ravel()
    fitted, is_sharp = _refine_tags(picture, grey, corners_px, board.spacing, tuning)
    places, covariance_px2 = fitted.places_px[is_sharp], fitted.covariance_px2[is_sharp]
    return build_detection(index[None, is_sharp], places, covariance_px2, picture.size_px)


def _expect_pattern(board: Charuco, markers: Mapping[int, Float[np.ndarray, "4 2"]]) -> None:
    """Raises DetectionError where the markers lie as in the other pattern of OpenCV's versions.

    With an odd number of columns both differ by a shift of one square, but for some markers at the
    sides, so that corners are found one square from where they are.
    """
    if board.rows % 2 or board.columns % 2 == 0:
        return
    other = replace(board, legacy=not board.legacy)
    stated_count, other_count = (count_beside_neighbours(markers, b) for b in (board, other))
    if other_count >= stated_count + _MORE_IN_PLACE:
        raise DetectionError(
            f"{other_count} markers of {board.dictionary} are visible where the board "
            f"{board.name!r} has them with legacy={'yes' if other.legacy else 'no'}: correct its "
            "layout."
        )


def corners_by_number(
    corners: Sequence[np.ndarray], numbers: np.ndarray | None
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Markers as OpenCV's detectors return them."""
    if numbers is None:
        return {}
    return {
        int(number): np.asarray(each, dtype=np.float64).reshape(4, 2)
        for number, each in zip(np.ravel(numbers), corners, strict=True)
    }


def count_beside_neighbours(markers: Mapping[int, Float[np.ndarray, "4 2"]], board: Charuco) -> int:
    """How many markers lie beside the next ones in the picture as the board has them.

    markers : in the picture in which the board looks as its plain print does.

    A marker and those beside it are nearly an affine image of the board, whatever the lens.
    """
    numbers = [number for number in markers if number in board.numbers]
    if len(numbers) < 2:
        return 0
    plain = replace(board, mirrored=False)
    middles_mm = plain.markers_mm[np.array(numbers) - board.first]
    corners_px = np.stack([markers[number] for number in numbers])
    top_left, top_right, low_right, low_left = np.moveaxis(corners_px, 1, 0)
    along_x = (top_right - top_left + low_right - low_left) / (2 * board.marker_mm)
    along_y = (top_left - low_left + top_right - low_right) / (2 * board.marker_mm)
    count = min(_NEIGHBOURS, len(numbers) - 1)
    middles_px = corners_px.mean(axis=1)
    near = np.asarray(point_tree(middles_px).query(middles_px, count + 1)[1])[:, 1:]
    step_px, step_mm = (middle[near] - middle[:, None] for middle in (middles_px, middles_mm))
    stated_px = step_mm[..., :1] * along_x[:, None] + step_mm[..., 1:] * along_y[:, None]
    miss_px = np.linalg.norm(step_px - stated_px, axis=2)
    share = miss_px / np.maximum(np.linalg.norm(step_px, axis=2), 1e-9)
    return int(np.sum(np.median(share, axis=1) < _MOST_OFF))


def as_plain_print(
    grey: UInt8[np.ndarray, "h w"], *, inverted: bool, mirrored: bool
) -> UInt8[np.ndarray, "h w"]:
    """The picture in which an inverted or mirrored board looks as its plain print does."""
    upright = 255 - grey if inverted else grey
    return np.ascontiguousarray(upright[:, ::-1]) if mirrored else upright


def _describe_markers(board: Charuco, numbers: np.ndarray | None) -> str:
    """What a picture without the board's corners shows of its markers, and what to do."""
    if numbers is None or not len(numbers):
        return (
            f"no marker of {board.dictionary} is visible: see that dictionary, size and focus are "
            "right"
        )
    visible = _visible(np.ravel(numbers).tolist(), "marker", board.dictionary)
    return f"{visible}: show more of the board, and see that rows, columns and legacy are right"


def _describe_tags(board: AprilGrid, numbers: Collection[int]) -> str:
    """What a picture without the board shows of its tags, and what to do."""
    family = f"{board.dictionary} with a border of {board.border}"
    if not numbers:
        return (
            f"no tag of {family} is visible: see that dictionary, border, size and focus are right"
        )
    return (
        f"{_visible(numbers, 'tag', family)}: show more of the board, and see that rows, columns "
        "and first are right"
    )


def _visible(numbers: Collection[int], thing: str, family: str) -> str:
    if len(numbers) == 1:
        return f"1 {thing} of {family} is visible, number {min(numbers)}"
    return (
        f"{len(numbers)} {thing}s of {family} are visible, numbered {min(numbers)} to "
        f"{max(numbers)}"
    )


def tags_in_place(
    seen: Mapping[int, Float[np.ndarray, "4 2"]], board: AprilGrid, tuning: CalibTuning
) -> tuple[Int[np.ndarray, "t"], Float[np.ndarray, "t 4 2"]]:
    """Which tags lie as the board has them, and their corners in the board's order.

    Programs print tags turned by quarters: all of a board are turned alike, and the turn that puts
    most of them in place is theirs.

    seen : corners by the number of the tag, see `read_tags`.
    """
    tags = np.array([k for k in sorted(seen) if k in board.numbers], dtype=int)
    if len(tags) < tuning.detection.fewest_tags:
        return np.zeros(0, dtype=int), np.zeros((0, 4, 2))
    corners_px, tags = np.stack([seen[number] for number in tags]), tags - board.first
    places = board.centres_mm.reshape(-1, 4, 2)[tags]
    # OpenCV goes round clockwise in the picture, the board's order counter-clockwise.
    turned = [corners_px[:, np.roll([3, 2, 1, 0], quarters)] for quarters in range(4)]
    off = [_distances_in_sides(places, corners) for corners in turned]
    best = int(np.argmin([np.median(each) for each in off]))
    kept = off[best] < tuning.detection.most_off_sides
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


def _refine_tags(
    image: SearchImage,
    grey: UInt8[np.ndarray, "h w"],
    corners_px: Float[np.ndarray, "t 4 2"],
    spacing: float,
    tuning: CalibTuning,
) -> tuple[FittedCorners, Bool[np.ndarray, "n"]]:
    """(places, which of them the picture shows as corners between dark squares)."""
    side = np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=1), axis=2).min(axis=1)
    gap, start = np.repeat(spacing * side, 4), corners_px.reshape(-1, 2)
    fitted = refine_corners(image, grey, start, gap, tuning)
    # Farther, a corner is nearer to another one.
    sharp = np.linalg.norm(fitted.places_px - start, axis=1) < np.maximum(0.5 * gap, 1.5)
    return fitted, sharp & _is_saddle(grey, corners_px, fitted.places_px, spacing, tuning)


def _is_saddle(
    grey: UInt8[np.ndarray, "h w"],
    corners_px: Float[np.ndarray, "t 4 2"],
    places: Float[np.ndarray, "n 2"],
    spacing: float,
    tuning: CalibTuning,
) -> Bool[np.ndarray, "n"]:
    """Whether the tag and the square opposite are alike dark, and both gaps alike light."""
    reach = tuning.detection.field_share * spacing
    one = reach * (np.roll(corners_px, -1, axis=1) - corners_px).reshape(-1, 2)
    other = reach * (np.roll(corners_px, 1, axis=1) - corners_px).reshape(-1, 2)
    ways = np.stack([one + other, -one - other, one - other, other - one])
    at = (places + ways).astype(np.float32)
    border = cv2.BORDER_REPLICATE
    levels = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=border)
    dark, light = levels.astype(np.float64).reshape(2, 2, -1)
    contrast = light.mean(axis=0) - dark.mean(axis=0)
    unlike = np.maximum(np.ptp(dark, axis=0), np.ptp(light, axis=0))
    return (contrast > 0) & (unlike < tuning.detection.alike_share * contrast)


class Figure(NamedTuple):
    """A quadrangle that may be a tag: its corners in an enlarged picture, and the enlargement."""

    grey: UInt8[np.ndarray, "h w"]
    scale: int
    corners_px: Float[np.ndarray, "4 2"]

    @property
    def side_px(self) -> float:
        """Mean side, in pixels of the picture itself."""
        sides = self.corners_px - np.roll(self.corners_px, 1, axis=0)
        return float(np.linalg.norm(sides, axis=1).mean()) / self.scale


def list_figures(
    grey: UInt8[np.ndarray, "h w"],
    dictionary: cv2.aruco.Dictionary,
    border: int,
    tuning: CalibTuning,
) -> list[Figure]:
    """What may be a tag. Another dictionary or border gives nearly the same figures.

    Tags touch their neighbours at the corners, and OpenCV takes what touches for one figure: light
    is widened until corners part, and the tags are read in the picture as it is. OpenCV's own
    reading of the widened picture finds half as many tags in soft pictures, and next to none of
    tags 40 px wide.
    """
    figures = []
    for scale, wide in tuning.detection.tag_scales:
        if scale > 1 and grey.size > tuning.detection.most_enlarged_px:
            continue
        large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        found = _find_quadrangles(large, dictionary, border, wide)
        figures += [Figure(large, scale, corners) for corners in found]
    return figures


def read_tags(
    figures: Iterable[Figure],
    dictionary: cv2.aruco.Dictionary,
    border: int,
    tuning: CalibTuning,
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Corners of each tag by number, from its top left clockwise in the picture, some px off.

    A number that is read at two places is left out: one of them belongs to another board.
    """
    tags: dict[int, Float[np.ndarray, "4 2"]] = {}
    twice = set()
    for large, scale, corners in figures:
        read = _read_tag(large, corners, dictionary, border, tuning)
        if read is None:
            continue
        number, turn = read
        # The middle of the first pixel stays the middle of the first pixel.
        place = (np.roll(corners, turn, axis=0) + 0.5) / scale - 0.5
        known = tags.setdefault(number, place)
        side = float(np.linalg.norm(np.diff(known, axis=0), axis=1).min())
        if np.linalg.norm(known.mean(axis=0) - place.mean(axis=0)) > 0.5 * side:
            twice.add(number)
    return {number: corners for number, corners in tags.items() if number not in twice}


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
    tuning: CalibTuning,
) -> tuple[int, int] | None:
    """(number, by how many corners the tag is turned); None for what is no tag."""
    cells = dictionary.markerSize + 2 * border
    side = cells * _CELL_PX
    square = side * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32) - 0.5
    to_square = cv2.getPerspectiveTransform(corners.astype(np.float32), square)
    flat = cv2.warpPerspective(grey, to_square, (side, side))
    light = cv2.threshold(flat, 0, 1, cv2.THRESH_OTSU)[1]
    middle = slice(_RIM_PX, _CELL_PX - _RIM_PX)
    share = light.reshape(cells, _CELL_PX, cells, _CELL_PX)[:, middle, :, middle].mean(axis=(1, 3))
    bits: Bool[np.ndarray, "c c"] = share > 0.5
    code = bits[border:-border, border:-border]
    if bits.sum() - code.sum() > tuning.detection.most_wrong * (bits.size - code.size):
        return None
    correctable = cv2.aruco.DetectorParameters().errorCorrectionRate
    is_one, number, turn = dictionary.identify(code.astype(np.uint8), correctable)
    return (int(number), int(turn)) if is_one else None
