"""The corners of a ChArUco board, labelled by the markers beside them, by OpenCV's detector.

Source: S. Garrido-Jurado et al., "Automatic generation and detection of highly reliable fiducial
markers under occlusion", Pattern Recognition 47(6), 2014 (`cv2.aruco.CharucoDetector`).
"""

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8

from trinoc.calib.detection.chessboard import levels_of_8_bit
from trinoc.calib.detection.corner_accuracy import corner_covariance_px2
from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.grey import search_image
from trinoc.calib.targets import Charuco, opencv_board
from trinoc.errors import DetectionError

FEWEST_CORNERS = 6


def detect_charuco(image: Shaped[np.ndarray, "..."], board: Charuco) -> Detection:
    """The corners of a ChArUco board that the picture shows, whole or in part.

    Raises DetectionError where no such board is seen, or too little of it, or its mirror image.
    """
    picture = search_image(image)
    grey = levels_of_8_bit(picture.grey)
    detector = cv2.aruco.CharucoDetector(opencv_board(board))
    corners_px, index = _found(detector, grey)
    if len(index) < FEWEST_CORNERS:
        mirrored = np.ascontiguousarray(grey[:, ::-1])
        if len(_found(detector, mirrored)[1]) >= FEWEST_CORNERS:
            raise DetectionError(
                f"The picture shows the board {board.name!r} as in a mirror; flip the picture, or "
                "see how the camera's driver delivers it."
            )
        raise DetectionError(
            f"The picture shows {len(index)} corners of the board {board.name!r}, but "
            f"{FEWEST_CORNERS} are needed; see that dictionary, size and focus are right."
        )
    order = np.argsort(index)
    corners_px, index = corners_px[order], index[order]
    return Detection(
        circle_index=index,
        centres_px=corners_px,
        covariance_px2=corner_covariance_px2(picture, corners_px),
        shape_px2=np.full((len(index), 2, 2), np.nan),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=picture.size_px,
    )


def _found(
    detector: cv2.aruco.CharucoDetector, grey: UInt8[np.ndarray, "h w"]
) -> tuple[np.ndarray, np.ndarray]:
    corners, index, _, _ = detector.detectBoard(grey)
    if corners is None or index is None:
        return np.zeros((0, 2)), np.zeros(0, dtype=int)
    places = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return places, np.asarray(index).reshape(-1).astype(int)
