"""OpenCV's line segment detector with a corrected bias, as an alternative to `find_segments`."""

import cv2
import numpy as np
from jaxtyping import Shaped

from trinoc.geometry.segments import Segments
from trinoc.image.grey import grey_image
from trinoc.segments.junctions import with_junctions
from trinoc.segments.side_intensity import with_side_levels

# Constant offset of OpenCV's segments from their edges, in u and v, measured on edges at all
# angles. It is subtracted.
# numerical: properties of that detector.
LSD_BIAS_PX = np.array([-0.123, -0.119])
LSD_SIGMA_PX = 0.1  # numerical: as above
LSD_SIGMA_ALONG_PX = 2.0  # numerical: as above


def find_segments_lsd(image: Shaped[np.ndarray, "..."]) -> Segments:
    """Detect straight edges with OpenCV's LSD, and correct the constant bias of its positions.

    Parameters
    ----------
    image : (h, w) or (h, w, channels)
        As in `find_segments`.

    Returns
    -------
    Segments
        Segments with junctions, chains and side levels. Polarity and contrast are unknown. All
        segments have the same sigmas.

    Raises
    ------
    InputError
        If the argument is not an image.

    References
    ----------
    R. Grompone von Gioi et al., "LSD: a line segment detector", Image Processing On Line 2, 2012,
    doi:10.5201/ipol.2012.gjmr-lsd.
    """
    picture = grey_image(image).in_255ths()
    levels = np.clip(np.rint(picture.grey), 0, 255).astype(np.uint8)
    detections = cv2.createLineSegmentDetector().detect(levels)[0]
    rows = (
        np.zeros((0, 4))
        if detections is None
        else np.asarray(detections, np.float64).reshape(-1, 4)
    )
    segments = with_junctions(
        Segments.from_endpoints(
            rows - np.tile(LSD_BIAS_PX, 2),
            sigma_px=LSD_SIGMA_PX,
            sigma_along_px=LSD_SIGMA_ALONG_PX,
            image_size_px=picture.size_px,
        )
    )
    return with_side_levels(segments, image)
