"""Detection of boards with markers: ChArUco boards with OpenCV, AprilTag grids with own code.

References
----------
S. Garrido-Jurado et al., "Automatic generation and detection of highly reliable fiducial markers
under occlusion", Pattern Recognition 47(6), 2014 (`cv2.aruco.CharucoDetector`).
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

# numerical: number of neighbours that a marker predicts, and largest median error of the prediction
# over the distance to the neighbour. In a wrong layout the error is about that distance.
_NEIGHBOURS, _LARGEST_ERROR = 3, 0.3
# numerical: additional consistent markers that reveal the layout of the other OpenCV version.
_MORE_IN_PLACE = 2
# numerical: side of a rectified cell, px, and width of its rim that is ignored because of blur.
_CELL_PX, _RIM_PX = 8, 2


def detect_charuco(
    image: Shaped[np.ndarray, "..."], board: Charuco, tuning: CalibTuning
) -> Detection:
    """Detect the visible corners of a ChArUco board.

    Parameters
    ----------
    image : grey or colour image.
    board : the board.
    tuning : tuned constants of calibration.

    Raises
    ------
    DetectionError : the image shows no such board, or too little of it.
    """
    search_input = search_image(image)
    grey, fewest = levels_of_8_bit(search_input.grey), tuning.detection.fewest_places
    detector = cv2.aruco.CharucoDetector(opencv_board(board))
    plain = undo_print_options(grey, inverted=board.inverted, mirrored=board.mirrored)
    corners, index, marker_corners, ids = detector.detectBoard(plain)
    count = 0 if index is None else len(index)
    if corners is None or index is None or count < fewest:
        raise DetectionError(
            f"The image shows {count} corners of the board {board.name!r}, but {fewest} are "
            f"needed; {_describe_markers(board, ids)}."
        )
    _check_legacy(board, corners_by_id(marker_corners, ids))
    order = np.argsort(np.ravel(index))
    index = np.ravel(index)[order].astype(int)
    corners_px = np.asarray(corners, dtype=np.float64).reshape(-1, 2)[order]
    if board.mirrored:
        corners_px[:, 0] = grey.shape[1] - 1 - corners_px[:, 0]
    # OpenCV 4 shifts corners by half a pixel: refine them, in windows without markers.
    clearance = distances_to_next(corners_px) * (1 - board.marker_mm / board.square_mm)
    fitted = refine_corners(search_input, grey, corners_px, clearance, tuning)
    return build_detection(index[None], *fitted, search_input.size_px)


def detect_april_grid(
    image: Shaped[np.ndarray, "..."], board: AprilGrid, tuning: CalibTuning
) -> Detection:
    """Detect the corners of the visible tags of an AprilTag grid.

    Parameters
    ----------
    image : grey or colour image.
    board : the board.
    tuning : tuned constants of calibration.

    Raises
    ------
    DetectionError : the image shows no such board, or too little of it.
    """
    search_input = search_image(image)
    grey = levels_of_8_bit(search_input.grey)
    dictionary = opencv_dictionary(board.dictionary)
    quadrangles = list_quadrangles(grey, dictionary, board.border, tuning)
    corners_of_tag = read_tags(quadrangles, dictionary, board.border, tuning)
    tags, corners_px = select_tags_in_place(corners_of_tag, board, tuning)
    fewest = tuning.detection.fewest_tags
    if len(tags) < fewest:
        raise DetectionError(
            f"The image shows {len(tags)} tags of the board {board.name!r}, but {fewest} "
            f"are needed; {_describe_tags(board, corners_of_tag)}."
        )
    index = (4 * tags[:, None] + np.arange(4)).ravel()
    fitted, is_saddle = _refine_tags(search_input, grey, corners_px, board.spacing, tuning)
    return build_detection(
        index[None, is_saddle],
        fitted.corners_px[is_saddle],
        fitted.covariance_px2[is_saddle],
        search_input.size_px,
    )


def _check_legacy(board: Charuco, markers: Mapping[int, Float[np.ndarray, "4 2"]]) -> None:
    """Raise `DetectionError` if the markers agree better with the opposite value of `legacy`.

    `legacy` selects the layout of OpenCV before version 4.6. If the number of columns is odd, the
    two layouts differ mainly by a shift of one square. All corners would then have wrong labels.

    markers : corners of each marker by its id.
    """
    if board.rows % 2 or board.columns % 2 == 0:
        return
    other = replace(board, legacy=not board.legacy)
    stated_count, other_count = (count_markers_in_place(markers, b) for b in (board, other))
    if other_count >= stated_count + _MORE_IN_PLACE:
        raise DetectionError(
            f"{other_count} markers of {board.dictionary} are visible at the positions that the "
            f"board {board.name!r} has with legacy={'yes' if other.legacy else 'no'}: correct "
            "the layout file."
        )


def corners_by_id(
    corners: Sequence[np.ndarray], ids: np.ndarray | None
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Corners of each marker by its id, clockwise from the top left.

    Parameters
    ----------
    corners, ids : output of OpenCV's marker detectors.
    """
    if ids is None:
        return {}
    return {
        int(marker_id): np.asarray(quadrangle, dtype=np.float64).reshape(4, 2)
        for marker_id, quadrangle in zip(np.ravel(ids), corners, strict=True)
    }


def count_markers_in_place(markers: Mapping[int, Float[np.ndarray, "4 2"]], board: Charuco) -> int:
    """Number of markers whose positions relative to their neighbours agree with the board.

    Whatever the lens, the image of a marker and its neighbours is approximately an affine
    transformation of the board.

    Parameters
    ----------
    markers : corners of each marker by its id, from an image converted by `undo_print_options`.
    board : the board.
    """
    ids = [marker_id for marker_id in markers if marker_id in board.marker_ids]
    if len(ids) < 2:
        return 0
    plain = replace(board, mirrored=False)
    middles_mm = plain.markers_mm[np.array(ids) - board.first]
    corners_px = np.stack([markers[marker_id] for marker_id in ids])
    top_left, top_right, low_right, low_left = np.moveaxis(corners_px, 1, 0)
    along_x = (top_right - top_left + low_right - low_left) / (2 * board.marker_mm)
    along_y = (top_left - low_left + top_right - low_right) / (2 * board.marker_mm)
    count = min(_NEIGHBOURS, len(ids) - 1)
    middles_px = corners_px.mean(axis=1)
    neighbours = np.asarray(point_tree(middles_px).query(middles_px, count + 1)[1])[:, 1:]
    step_px, step_mm = (middle[neighbours] - middle[:, None] for middle in (middles_px, middles_mm))
    predicted_px = step_mm[..., :1] * along_x[:, None] + step_mm[..., 1:] * along_y[:, None]
    error_px = np.linalg.norm(step_px - predicted_px, axis=2)
    share = error_px / np.maximum(np.linalg.norm(step_px, axis=2), 1e-9)
    return int(np.sum(np.median(share, axis=1) < _LARGEST_ERROR))


def undo_print_options(
    grey: UInt8[np.ndarray, "h w"], *, inverted: bool, mirrored: bool
) -> UInt8[np.ndarray, "h w"]:
    """Invert or mirror an image, so that an inverted or mirrored board appears normal.

    Parameters
    ----------
    grey : the image.
    inverted, mirrored : print options of the board.
    """
    upright = 255 - grey if inverted else grey
    return np.ascontiguousarray(upright[:, ::-1]) if mirrored else upright


def _describe_markers(board: Charuco, ids: np.ndarray | None) -> str:
    """Return a clause on the visible markers, with a remedy, for an image with too few corners.

    ids : ids of the visible markers.
    """
    if ids is None or not len(ids):
        return (
            f"no marker of {board.dictionary} is visible: check the dictionary, the size of the "
            "board and the focus"
        )
    visible = _visible(np.ravel(ids).tolist(), "marker", board.dictionary)
    return f"{visible}: show more of the board, and check rows, columns and legacy"


def _describe_tags(board: AprilGrid, ids: Collection[int]) -> str:
    """Return a clause on the visible tags, with a remedy, for an image with too few tags.

    ids : ids of the visible tags.
    """
    family = f"{board.dictionary} with a border of {board.border}"
    if not ids:
        return (
            f"no tag of {family} is visible: check the dictionary, the border, the size of the "
            "board and the focus"
        )
    return (
        f"{_visible(ids, 'tag', family)}: show more of the board, and check rows, columns and first"
    )


def _visible(ids: Collection[int], thing: str, family: str) -> str:
    if len(ids) == 1:
        return f"1 {thing} of {family} is visible, number {min(ids)}"
    return f"{len(ids)} {thing}s of {family} are visible, numbered {min(ids)} to {max(ids)}"


def select_tags_in_place(
    corners_of_tag: Mapping[int, Float[np.ndarray, "4 2"]], board: AprilGrid, tuning: CalibTuning
) -> tuple[Int[np.ndarray, "t"], Float[np.ndarray, "t 4 2"]]:
    """Select the tags whose positions agree with the layout of the board.

    Some programs print all tags of a board rotated by quarter turns. The rotation with the smallest
    median error is used.

    Parameters
    ----------
    corners_of_tag : corners of each tag by its id, from `read_tags`.
    board : the expected board.
    tuning : tuned constants of calibration.

    Returns
    -------
    (t,) indices of the tags on the board, and (t, 4, 2) their corners in the order of the board.
    """
    tags = np.array([k for k in sorted(corners_of_tag) if k in board.marker_ids], dtype=int)
    if len(tags) < tuning.detection.fewest_tags:
        return np.zeros(0, dtype=int), np.zeros((0, 4, 2))
    corners_px = np.stack([corners_of_tag[marker_id] for marker_id in tags])
    tags = tags - board.first
    corners_mm = board.centres_mm.reshape(-1, 4, 2)[tags]
    # OpenCV orders corners clockwise in the image, the board counter-clockwise.
    turned = [corners_px[:, np.roll([3, 2, 1, 0], quarters)] for quarters in range(4)]
    errors = [_distances_in_sides(corners_mm, corners) for corners in turned]
    best = int(np.argmin([np.median(error) for error in errors]))
    in_place = errors[best] < tuning.detection.most_off_sides
    return tags[in_place], turned[best][in_place]


def _distances_in_sides(
    corners_mm: Float[np.ndarray, "t 4 2"], corners_px: Float[np.ndarray, "t 4 2"]
) -> Float[np.ndarray, "t"]:
    """Largest deviation of each tag's corners from a robust homography, in sides of the tag."""
    flat = corners_mm.reshape(-1, 1, 2)
    homography, _ = cv2.findHomography(flat, corners_px.reshape(-1, 1, 2), cv2.LMEDS)
    if homography is None:
        return np.full(len(corners_mm), np.inf)
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
    """Refined corners of all tags, and the mask of the corners that are saddle points.

    spacing : gap between two tags divided by the side of a tag.
    """
    side = np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=1), axis=2).min(axis=1)
    gap, start = np.repeat(spacing * side, 4), corners_px.reshape(-1, 2)
    fitted = refine_corners(image, grey, start, gap, tuning)
    # After a larger move, another corner would be nearer.
    is_near = np.linalg.norm(fitted.corners_px - start, axis=1) < np.maximum(0.5 * gap, 1.5)
    return fitted, is_near & _is_saddle(grey, corners_px, fitted.corners_px, spacing, tuning)


def _is_saddle(
    grey: UInt8[np.ndarray, "h w"],
    corners_px: Float[np.ndarray, "t 4 2"],
    refined_px: Float[np.ndarray, "n 2"],
    spacing: float,
    tuning: CalibTuning,
) -> Bool[np.ndarray, "n"]:
    """Mask of the corners with plausible grey levels in the four quadrants around them.

    The tag and the opposite square must be equally dark, and the gaps between tags equally light.

    corners_px, refined_px : corners before and after refinement.
    spacing : gap between two tags divided by the side of a tag.
    """
    reach = tuning.detection.field_share * spacing
    one = reach * (np.roll(corners_px, -1, axis=1) - corners_px).reshape(-1, 2)
    other = reach * (np.roll(corners_px, 1, axis=1) - corners_px).reshape(-1, 2)
    offsets = np.stack([one + other, -one - other, one - other, other - one])
    fields = (refined_px + offsets).astype(np.float32)
    border = cv2.BORDER_REPLICATE
    levels = cv2.remap(grey, fields[..., 0], fields[..., 1], cv2.INTER_LINEAR, borderMode=border)
    dark, light = levels.astype(np.float64).reshape(2, 2, -1)
    contrast = light.mean(axis=0) - dark.mean(axis=0)
    difference = np.maximum(np.ptp(dark, axis=0), np.ptp(light, axis=0))
    return (contrast > 0) & (difference < tuning.detection.alike_share * contrast)


class Quadrangle(NamedTuple):
    """A dark quadrangle of an image, which may be a tag.

    Attributes
    ----------
    grey : the image, enlarged by `scale`.
    scale : factor of the enlargement.
    corners_px : (4, 2) corners in the enlarged image.
    """

    grey: UInt8[np.ndarray, "h w"]
    scale: int
    corners_px: Float[np.ndarray, "4 2"]

    @property
    def side_px(self) -> float:
        """Mean side of the quadrangle, in pixels of the original image."""
        sides = self.corners_px - np.roll(self.corners_px, 1, axis=0)
        return float(np.linalg.norm(sides, axis=1).mean()) / self.scale


def list_quadrangles(
    grey: UInt8[np.ndarray, "h w"],
    dictionary: cv2.aruco.Dictionary,
    border: int,
    tuning: CalibTuning,
) -> list[Quadrangle]:
    """List the dark quadrangles that may be tags.

    The result hardly depends on the dictionary and the border.

    Parameters
    ----------
    grey : grey levels of the image.
    dictionary : OpenCV's dictionary of the tags.
    border : width of the black border of a tag, in cells.
    tuning : tuned constants of calibration.

    Notes
    -----
    The tags touch the squares between them, and OpenCV merges shapes that touch. The light regions
    are therefore dilated before the search. The ids are later read from the original image, because
    the dilation makes small and blurred tags unreadable.
    """
    quadrangles = []
    for scale, dilation_px in tuning.detection.tag_scales:
        if scale > 1 and grey.size > tuning.detection.most_enlarged_px:
            continue
        large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        for corners in _find_quadrangles(large, dictionary, border, dilation_px):
            quadrangles.append(Quadrangle(large, scale, corners))
    return quadrangles


def read_tags(
    quadrangles: Iterable[Quadrangle],
    dictionary: cv2.aruco.Dictionary,
    border: int,
    tuning: CalibTuning,
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Read the ids of tags.

    An id at two positions is excluded, because one of them belongs to another board.

    Parameters
    ----------
    quadrangles : quadrangles that may be tags.
    dictionary : OpenCV's dictionary of the tags.
    border : width of the black border of a tag, in cells.
    tuning : tuned constants of calibration.

    Returns
    -------
    Corners of each tag by its id, (4, 2) px, accurate to some pixels. They start at the top left of
    the tag and go clockwise in the image.
    """
    tags: dict[int, Float[np.ndarray, "4 2"]] = {}
    duplicates = set()
    for large, scale, corners in quadrangles:
        tag = _read_tag(large, corners, dictionary, border, tuning)
        if tag is None:
            continue
        marker_id, turn = tag
        # The origin is the centre of the first pixel at both sizes.
        corners_px = (np.roll(corners, turn, axis=0) + 0.5) / scale - 0.5
        previous = tags.setdefault(marker_id, corners_px)
        side = float(np.linalg.norm(np.diff(previous, axis=0), axis=1).min())
        if np.linalg.norm(previous.mean(axis=0) - corners_px.mean(axis=0)) > 0.5 * side:
            duplicates.add(marker_id)
    return {
        marker_id: corners for marker_id, corners in tags.items() if marker_id not in duplicates
    }


def _find_quadrangles(
    grey: UInt8[np.ndarray, "h w"], dictionary: cv2.aruco.Dictionary, border: int, dilation_px: int
) -> list[Float[np.ndarray, "4 2"]]:
    """Corners of dark quadrangles, after dilation of the light regions by `dilation_px`.

    The corners are corrected for the dilation.
    """
    options = cv2.aruco.DetectorParameters()
    options.markerBorderBits = border
    dilated = cv2.dilate(grey, np.ones((dilation_px, dilation_px), np.uint8))
    markers, _, rejected = cv2.aruco.ArucoDetector(dictionary, options).detectMarkers(dilated)
    quadrangles = []
    for quadrangle in (*markers, *rejected):
        corners = np.asarray(quadrangle, dtype=np.float64).reshape(4, 2)
        side = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean()
        middle = corners.mean(axis=0)
        quadrangles.append(middle + (corners - middle) * (1 + (dilation_px - 1) / side))
    return quadrangles


def _read_tag(
    grey: UInt8[np.ndarray, "h w"],
    corners: Float[np.ndarray, "4 2"],
    dictionary: cv2.aruco.Dictionary,
    border: int,
    tuning: CalibTuning,
) -> tuple[int, int] | None:
    """Id of a tag and number of quarter turns of its corners; None if the quadrangle is no tag."""
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
    is_marker, marker_id, turn = dictionary.identify(code.astype(np.uint8), correctable)
    return (int(marker_id), int(turn)) if is_marker else None
