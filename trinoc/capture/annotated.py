"""Annotated image for a failed detection of the sheet."""

import textwrap
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8

from trinoc.calib.detection.circles import circle_candidates
from trinoc.image.grey import grey_image

_LARGEST_SIDE_PX, _LEAST_WIDTH_PX = 1600, 640
# Red, green, blue.
_CANDIDATE, _TEXT, _PAPER = (230, 110, 0), (20, 20, 20), (255, 255, 255)
_LINE_PX, _LETTER_PX, _FONT_SCALE = 26, 10.0, 0.55


def failure_picture(
    image: Shaped[np.ndarray, "..."], sentences: Sequence[str]
) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the circle candidates of an image below sentences that explain the failure.

    Parameters
    ----------
    image : (h, w) or (h, w, channels)
        Image of any range.
    sentences : sequence of str
        Explanations.

    Returns
    -------
    (h, w, 3) uint8
        Red, green, blue. The image part has no side longer than 1600 px.
    """
    candidates = circle_candidates(image)
    grey = grey_image(image).as_8_bit()
    scale = min(1.0, _LARGEST_SIDE_PX / max(grey.shape))
    scale = max(scale, _LEAST_WIDTH_PX / grey.shape[1])
    size = round(grey.shape[1] * scale), round(grey.shape[0] * scale)
    canvas = cv2.cvtColor(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2RGB)
    for centre, shape in zip(candidates.centres_px, candidates.shape_px2, strict=True):
        squared, axes = np.linalg.eigh(shape)
        middle = scale * (centre + 0.5) - 0.5
        half = scale * np.sqrt(np.maximum(squared[::-1], 0)) + 3
        angle = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
        box = (middle.tolist(), (2 * half).tolist(), angle)
        cv2.ellipse(canvas, box, _CANDIDATE, 2, cv2.LINE_AA)
    lines = [f"{sentence[:1].upper()}{sentence[1:].removesuffix('.')}." for sentence in sentences]
    count = f"{len(candidates)} dark spots could be circles; they are drawn around."
    return np.concatenate([_caption([*lines, count], size[0]), canvas])


def _caption(sentences: Sequence[str], width_px: int) -> UInt8[np.ndarray, "h w 3"]:
    letters = int((width_px - 24) / _LETTER_PX)
    lines = [line for sentence in sentences for line in textwrap.wrap(sentence, letters)]
    strip = np.full((_LINE_PX * len(lines) + 16, width_px, 3), _PAPER, dtype=np.uint8)
    for k, line in enumerate(lines):
        position = (12, _LINE_PX * (k + 1) - 4)
        text = line.encode("ascii", "replace").decode()
        cv2.putText(
            strip, text, position, cv2.FONT_HERSHEY_SIMPLEX, _FONT_SCALE, _TEXT, 1, cv2.LINE_AA
        )
    return strip
