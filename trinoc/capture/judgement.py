"""One picture of a board: is it good to calibrate with, and if not, why?"""

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


class Judgement(NamedTuple):
    """What was seen of the board in one picture.

    Fields
    ------
    name : of the picture.
    size_px : (width, height); (0, 0) of a file that could not be read.
    places_px : (m, 2) circles or corners found; none where the board was refused.
    places_mm : (m, 2) where on the board these are.
    of_places : how many the board has.
    kind : "circles" or "corners".
    refusal : why the board was not found; "" where it was.
    blur_px : width of the edges, as the sigma of a Gaussian; NaN where there are hardly any.
    exposure : of the board where it was found, else of the whole picture.
    lean : see `measure_lean`.
    faults : what is wrong with the picture, each with what to do; where the board was not found,
        perhaps the cause.
    """

    name: str
    size_px: tuple[int, int]
    places_px: Float[np.ndarray, "m 2"]
    places_mm: Float[np.ndarray, "m 2"]
    of_places: int
    kind: str
    refusal: str
    blur_px: float
    exposure: Exposure
    lean: tuple[float, float]
    faults: tuple[str, ...]

    @property
    def found(self) -> bool:
        """Whether the board was found."""
        return not self.refusal

    @property
    def good(self) -> bool:
        """Whether to keep the picture."""
        return self.found and not self.faults


def judge(
    name: str,
    image: Shaped[np.ndarray, "..."],
    target: AbstractTarget,
    search: ReadingSearch | None = None,
    camera: str = "",
) -> Judgement:
    """Look for the board in a picture, and measure sharpness and exposure where it stands.

    image : (h, w) or (h, w, channels), of any range. search : of other readings of the board, which
    the pictures of several cameras share; one of its own unless given. camera : whose picture it
    is. Raises InputError for what is no picture.
    """
    picture = Light.from_picture(image)
    places, on_board, refusal = np.zeros((0, 2)), np.zeros((0, 2)), ""
    smallest = np.inf
    try:
        detection = detect_or_explain(image, target, search or ReadingSearch(target), camera)
    except DetectionError as error:
        refusal = str(error)
    else:
        places = np.asarray(detection.centres_px)
        on_board = np.asarray(target.centres_mm)[detection.circle_index]
        if target.point_kind == "circles":
            axes = np.linalg.eigvalsh(detection.shape_px2)[:, 0]
            smallest = 2 * float(np.sqrt(max(float(np.min(axes)), 0.0)))
    region = picture.light[_window(places, picture.size_px)]
    normals = edge_normals(on_board, places, round_ink=target.point_kind == "circles")
    blur = edge_blur_px(region, normals)
    exposure = measure_exposure(region)
    return Judgement(
        name=name,
        size_px=picture.size_px,
        places_px=places,
        places_mm=on_board,
        of_places=len(target),
        kind=target.point_kind,
        refusal=refusal,
        blur_px=blur,
        exposure=exposure,
        lean=measure_lean(on_board, places),
        faults=tuple(_faults(blur, exposure, smallest, seen=not refusal)),
    )


def judge_unread(name: str, target: AbstractTarget, why: str) -> Judgement:
    """What is to be said of a file that is no picture."""
    none, nan = np.zeros((0, 2)), float("nan")
    unknown, kind = Exposure(nan, nan, nan), target.point_kind
    return Judgement(name, (0, 0), none, none, len(target), kind, why, nan, unknown, (0.0, 0.0), ())


def judgement_line(judgement: Judgement) -> str:
    """One line: what was found, sharpness, exposure, and what is wrong."""
    name = " ".join(judgement.name.split())
    if not judgement.found:
        perhaps = f" Perhaps because {'; '.join(judgement.faults)}." if judgement.faults else ""
        return f"{name}: NOT FOUND, {judgement.refusal}{perhaps}"
    verdict = "good" if judgement.good else "AGAIN"
    blur = "?" if math.isnan(judgement.blur_px) else f"{judgement.blur_px:.1f}"
    parts = [
        f"{len(judgement.places_px)} of {judgement.of_places} {judgement.kind}",
        f"edges {blur} px",
        f"saturated {judgement.exposure.saturated:.1%}, dark {judgement.exposure.dark:.1%}",
        *judgement.faults,
    ]
    return f"{name}: {verdict}, {'; '.join(parts)}"


def _window(places_px: Float[np.ndarray, "m 2"], size_px: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns that hold the board, or all of them."""
    if not len(places_px):
        return slice(None), slice(None)
    low, high = places_px.min(axis=0), places_px.max(axis=0)
    room = _MARGIN * (high - low) + 12.0
    left, upper = np.maximum(np.floor(low - room), 0).astype(int)
    right, lower = np.minimum(np.ceil(high + room), size_px).astype(int)
    return slice(upper, lower), slice(left, right)


def _faults(blur_px: float, exposure: Exposure, smallest_px: float, *, seen: bool) -> list[str]:
    found = []
    if not seen and math.isnan(blur_px):
        found.append(
            "hardly anything has an edge: see that the lens cap is off, and the file right"
        )
    if blur_px > SOFTEST_PX:
        found.append(f"edges are {blur_px:.1f} px wide: focus on the board, hold it still")
    if exposure.saturated > MOST_SATURATED:
        found.append(f"{exposure.saturated:.0%} is saturated: shorten the exposure")
    if exposure.paper < DARKEST_PAPER:
        found.append(f"the paper reaches {exposure.paper:.0%} of white: more light")
    if smallest_px < SMALLEST_CIRCLE_PX:
        found.append(f"circles are {smallest_px:.0f} px across: nearer, or a larger sheet")
    return found
