"""How much of each picture the sheet's circles cover."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.calib import CalibrationResult, CameraFit
from trinoc.report.numbers import percent
from trinoc.report.pictures import PagePicture


class CoverageFigure(NamedTuple):
    """A whole picture with the centres of its circles and the outline that holds them.

    `share` is the area of the outline over that of the picture.
    """

    name: str
    picture: PagePicture
    centres_px: Float[np.ndarray, "m 2"]
    outline_px: Float[np.ndarray, "k 2"]
    share: float
    caption: str


def coverage_part(
    result: CalibrationResult, pictures: dict[str, PagePicture]
) -> tuple[CoverageFigure, ...]:
    """A figure for each camera in whose picture the sheet was found."""
    return tuple(
        _figure(name, fit, len(result.pattern), pictures[name]) for name, fit in result.fits.items()
    )


def _figure(name: str, fit: CameraFit, circles: int, picture: PagePicture) -> CoverageFigure:
    centres = np.asarray(fit.detection.centres_px)[np.asarray(fit.used)]
    outline = np.zeros((0, 2))
    if len(centres) >= 3:
        outline = cv2.convexHull(centres.astype(np.float32))[:, 0].astype(np.float64)
    width, height = fit.detection.image_size_px
    share = float(cv2.contourArea(outline.astype(np.float32))) / (width * height)
    caption = f"{percent(share)} of the picture, {len(centres)} of {circles} circles"
    return CoverageFigure(name, picture, centres, outline, share, caption)
