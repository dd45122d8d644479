"""The corners of a grid of AprilTags, labelled by the tags."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from trinoc.calib.detection.chessboard import levels_of_8_bit
from trinoc.calib.detection.corner_accuracy import corner_covariance_px2
from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.grey import search_image
from trinoc.calib.detection.tag_reading import tags_in
from trinoc.calib.targets import AprilGrid, opencv_dictionary
from trinoc.errors import DetectionError

FEWEST_TAGS = 2
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


def detect_april_grid(image: Shaped[np.ndarray, "..."], board: AprilGrid) -> Detection:
    """The corners of the tags that the picture shows, all of them or some.

    Raises DetectionError where no such board is seen, or too little of it, or its mirror image.
    """
    picture = search_image(image)
    grey = levels_of_8_bit(picture.grey)
    tags, corners_px = _found(grey, board)
    if len(tags) < FEWEST_TAGS:
        if len(_found(np.ascontiguousarray(grey[:, ::-1]), board)[0]) >= FEWEST_TAGS:
            raise DetectionError(
                f"The picture shows the board {board.name!r} as in a mirror; flip the picture, or "
                "see how the camera's driver delivers it."
            )
        raise DetectionError(
            f"The picture shows {len(tags)} tags of the board {board.name!r}, but {FEWEST_TAGS} "
            "are needed; see that dictionary, border, size and focus are right."
        )
    index = (4 * tags[:, None] + np.arange(4)).ravel()
    places, sharp = _refined(grey, corners_px, board.spacing)
    index, places = index[sharp], places[sharp]
    return Detection(
        circle_index=index,
        centres_px=places,
        covariance_px2=corner_covariance_px2(picture, places),
        shape_px2=np.full((len(index), 2, 2), np.nan),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=picture.size_px,
    )


def _found(
    grey: UInt8[np.ndarray, "h w"], board: AprilGrid
) -> tuple[Int[np.ndarray, "t"], Float[np.ndarray, "t 4 2"]]:
    """(which tags, their corners from the board's lower left counter-clockwise), by number."""
    seen = tags_in(grey, opencv_dictionary(board.dictionary), board.border)
    last = board.first + board.rows * board.columns
    own = {number: corners for number, corners in seen.items() if board.first <= number < last}
    if len(own) < FEWEST_TAGS:
        return np.zeros(0, dtype=int), np.zeros((0, 4, 2))
    tags = np.array(sorted(own))
    return _in_place(tags - board.first, np.stack([own[number] for number in tags]), board)


def _in_place(
    tags: Int[np.ndarray, "t"], corners_px: Float[np.ndarray, "t 4 2"], board: AprilGrid
) -> tuple[Int[np.ndarray, "t"], Float[np.ndarray, "t 4 2"]]:
    """Tags that lie as the board has them, with corners in the board's order.

    Programs print tags turned by quarters: all of a board are turned alike, and the turn that puts
    most of them in place is theirs.
    """
    places = board.centres_mm.reshape(-1, 4, 2)[tags]
    # OpenCV goes round clockwise in the picture, the board's order counter-clockwise.
    turned = [corners_px[:, np.roll([3, 2, 1, 0], quarters)] for quarters in range(4)]
    off = [_off_sides(places, corners) for corners in turned]
    best = int(np.argmin([np.median(each) for each in off]))
    kept = off[best] < _MOST_OFF
    return tags[kept], turned[best][kept]


def _off_sides(
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


def _refined(
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
    unlike = np.maximum(np.abs(np.ptp(dark, axis=0)), np.abs(np.ptp(light, axis=0)))
    return (contrast > 0) & (unlike < _ALIKE * contrast)
