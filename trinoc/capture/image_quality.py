"""Quality of one image of a board for calibration: detection, sharpness, exposure, faults."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from trinoc.calib.detection.marker_readings import ReadingSearch
from trinoc.calib.detection.registry import detect_or_explain
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.capture.measures import (
    Exposure,
    edge_blur_px,
    edge_normals,
    measure_exposure,
    measure_lean,
)
from trinoc.errors import DetectionError
from trinoc.image.light import Light

# Bounds of what docs/how-to.md asks for.
SOFTEST_PX = 2.5
MOST_SATURATED = 0.02
DARKEST_PAPER = 0.3
SMALLEST_CIRCLE_PX = 10.0
# Around the places, in their extent, so that the paper beside the outer ones is seen.
_MARGIN = 0.08


class ImageQuality(NamedTuple):
    """Detected points of the board in one image, and measures of the image's quality.

    Attributes
    ----------
    name : str
        Name of the image.
    size_px : (width, height)
        Size; (0, 0) for an unreadable file.
    points_px : (m, 2)
        Detected circles or corners; empty if the detection failed.
    points_mm : (m, 2)
        Their positions on the board.
    point_count : int
        Number of points on the board.
    kind : str
        "circles" or "corners".
    refusal : str
        Reason of a failed detection; "" if the board was detected.
    blur_px : float
        Blur of the edges as the sigma of a Gaussian; NaN with too few edges.
    exposure : Exposure
        Exposure of the board, or of the whole image if the board was not detected.
    lean : (2,)
        Tilt of the board, as in `measure_lean`.
    faults : tuple of str
        Faults of the image with remedies. After a failed detection, possible causes.
    """

    name: str
    size_px: tuple[int, int]
    points_px: Float[np.ndarray, "m 2"]
    points_mm: Float[np.ndarray, "m 2"]
    point_count: int
    kind: str
    refusal: str
    blur_px: float
    exposure: Exposure
    lean: tuple[float, float]
    faults: tuple[str, ...]

    @property
    def is_detected(self) -> bool:
        """True if the board was detected."""
        return not self.refusal

    @property
    def is_good(self) -> bool:
        """True if the image is good enough for calibration."""
        return self.is_detected and not self.faults


def measure_quality(
    name: str,
    image: Shaped[np.ndarray, "..."],
    target: AbstractTarget,
    search: ReadingSearch | None = None,
    camera: str = "",
) -> ImageQuality:
    """Detect the board in an image, and measure sharpness and exposure there.

    Parameters
    ----------
    name : str
        Name of the image.
    image : (h, w) or (h, w, channels)
        Image of any range.
    target : AbstractTarget
        The board.
    search : ReadingSearch, optional
        Search for other board layouts that agree with the images, in case `target` is wrong. The
        images of all cameras share one search. Default: a new search.
    camera : str
        Camera of the image.

    Returns
    -------
    ImageQuality

    Raises
    ------
    InputError
        If the argument is not an image.
    """
    picture = Light.from_picture(image)
    points_px, points_mm, refusal = np.zeros((0, 2)), np.zeros((0, 2)), ""
    smallest = np.inf
    try:
        detection = detect_or_explain(image, target, search or ReadingSearch(target), camera)
    except DetectionError as error:
        refusal = str(error)
    else:
        points_px = np.asarray(detection.centres_px)
        points_mm = np.asarray(target.centres_mm)[detection.circle_index]
        if target.point_kind == "circles":
            axes = np.linalg.eigvalsh(detection.shape_px2)[:, 0]
            smallest = 2 * float(np.sqrt(max(float(np.min(axes)), 0.0)))
    region = picture.light[_window(points_px, picture.size_px)]
    normals = edge_normals(points_mm, points_px, round_ink=target.point_kind == "circles")
    blur = edge_blur_px(region, normals)
    exposure = measure_exposure(region)
    return ImageQuality(
        name=name,
        size_px=picture.size_px,
        points_px=points_px,
        points_mm=points_mm,
        point_count=len(target),
        kind=target.point_kind,
        refusal=refusal,
        blur_px=blur,
        exposure=exposure,
        lean=measure_lean(points_mm, points_px),
        faults=tuple(_faults(blur, exposure, smallest, is_detected=not refusal)),
    )


def unreadable_quality(name: str, target: AbstractTarget, reason: str) -> ImageQuality:
    """Quality of a file that is not a readable image. reason : why it is not readable."""
    no_points, nan = np.zeros((0, 2)), float("nan")
    unknown, kind = Exposure(nan, nan, nan), target.point_kind
    return ImageQuality(
        name, (0, 0), no_points, no_points, len(target), kind, reason, nan, unknown, (0.0, 0.0), ()
    )


def quality_line(quality: ImageQuality) -> str:
    """One line: detected points, sharpness, exposure and faults."""
    name = " ".join(quality.name.split())
    if not quality.is_detected:
        possible_causes = f" Perhaps because {'; '.join(quality.faults)}." if quality.faults else ""
        return f"{name}: NOT FOUND, {quality.refusal}{possible_causes}"
    verdict = "good" if quality.is_good else "AGAIN"
    blur = "?" if math.isnan(quality.blur_px) else f"{quality.blur_px:.1f}"
    parts = [
        f"{len(quality.points_px)} of {quality.point_count} {quality.kind}",
        f"edges {blur} px",
        f"saturated {quality.exposure.saturated:.1%}, dark {quality.exposure.dark:.1%}",
        *quality.faults,
    ]
    return f"{name}: {verdict}, {'; '.join(parts)}"


def _window(points_px: Float[np.ndarray, "m 2"], size_px: tuple[int, int]) -> tuple[slice, slice]:
    """Slices of the rows and columns around the detected points, or of the whole image."""
    if not len(points_px):
        return slice(None), slice(None)
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    margin = _MARGIN * (high - low) + 12.0
    left, upper = np.maximum(np.floor(low - margin), 0).astype(int)
    right, lower = np.minimum(np.ceil(high + margin), size_px).astype(int)
    return slice(upper, lower), slice(left, right)


def _faults(
    blur_px: float, exposure: Exposure, smallest_px: float, *, is_detected: bool
) -> list[str]:
    faults = []
    if not is_detected and math.isnan(blur_px):
        faults.append(
            "the picture has almost no edges: check that the lens cap is off, and that this is the "
            "right file"
        )
    if blur_px > SOFTEST_PX:
        faults.append(
            f"edges are {blur_px:.1f} px wide: focus on the board, and hold the board still"
        )
    if exposure.saturated > MOST_SATURATED:
        faults.append(f"{exposure.saturated:.0%} of the pixels are saturated: shorten the exposure")
    if exposure.paper < DARKEST_PAPER:
        faults.append(f"the paper has only {exposure.paper:.0%} of the white level: use more light")
    if smallest_px < SMALLEST_CIRCLE_PX:
        faults.append(
            f"circles are only {smallest_px:.0f} px wide: move the camera nearer, or use a larger "
            "sheet"
        )
    return faults
