"""Single edges as cameras deliver them: how far a response, saturation, sharpening move them."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr

from simulation.camera_picture.delivery import SRGB
from trinoc.image.response import ResponseLike
from trinoc.segments import find_segments

SIDE_PX, NOISE, EDGES = 64, 1.5, 24
# Blur of the lens; the pixel's box adds its variance.
BLURS_PX = (0.7, 1.0, 1.5)
_PIXEL_VARIANCE = 1 / 12


class Delivery(NamedTuple):
    """Light of both sides, of full white, and what makes grey levels of 0 to 255 of it."""

    name: str
    dark: float
    bright: float
    delivered: Callable[[np.ndarray], np.ndarray]
    responses: tuple[ResponseLike, ...]


def _linear(light: np.ndarray) -> np.ndarray:
    return 255 * light


def _srgb(light: np.ndarray) -> np.ndarray:
    return 255 * SRGB().encode(np.minimum(light, 1.0))


def _sharpened(levels: np.ndarray, amount: float) -> np.ndarray:
    return levels + amount * (levels - cv2.GaussianBlur(levels, (0, 0), 1.0))


def deliveries() -> Iterator[Delivery]:
    """The conditions of the table in docs/segments.md."""
    both: tuple[ResponseLike, ...] = ("linear", "srgb")
    for dark, bright in ((0.2, 0.4), (0.4, 0.9), (0.05, 0.5), (0.02, 0.9)):
        yield Delivery("sRGB", dark, bright, _srgb, both)
    yield Delivery("sharpened by 1", 0.25, 0.6, lambda x: _sharpened(_linear(x), 1.0), ("linear",))
    for amount in (0.5, 1.0):
        yield Delivery(
            f"sRGB, sharpened by {amount:g}",
            0.05,
            0.5,
            lambda x, amount=amount: _sharpened(_srgb(x), amount),
            both,
        )
    for over in (1.1, 1.25, 1.5, 2.0, 3.0):
        yield Delivery("saturated", 0.2, 0.2 + 0.8 * over, _linear, ("linear",))
    for over in (1.25, 2.0):
        yield Delivery("sRGB, saturated", 0.05, 0.05 + 0.95 * over, _srgb, both)


def table_of_deliveries() -> None:
    """Print the mean shift toward the bright side, and the normalised errors."""
    print("\nSingle edges: shift toward the bright side; mean square of the normalised error")
    print("                        light of the sides  response     blur px: px (widths)")
    for one in deliveries():
        for response in one.responses:
            cells = []
            for blur in BLURS_PX:
                found = np.array(list(_errors(one, blur, response)))
                width = np.sqrt(blur**2 + _PIXEL_VARIANCE)
                shift, square = found[:, 0].mean(), np.mean(np.square(found[:, 1]))
                cells.append(f"{blur}: {shift:+.3f} ({shift / width:+.2f}) {square:7.2f}")
            sides = f"{one.dark:.2f} {one.bright:.2f}"
            print(f"  {one.name:24s} {sides:12s} {response!s:8s} {'   '.join(cells)}")


def _errors(one: Delivery, blur_px: float, response: ResponseLike) -> Iterator[tuple[float, float]]:
    """(px, claimed sigmas) of each edge toward its bright side, at angles all round."""
    width = np.sqrt(blur_px**2 + _PIXEL_VARIANCE)
    v, u = np.mgrid[:SIDE_PX, :SIDE_PX].astype(float)
    for seed in range(EDGES):
        rng = np.random.default_rng(seed)
        angle = 2 * np.pi * (seed + rng.uniform()) / EDGES
        middle, normal = rng.uniform(29, 34, 2), np.array([np.cos(angle), np.sin(angle)])
        across = (u - middle[0]) * normal[0] + (v - middle[1]) * normal[1]
        light = one.dark + (one.bright - one.dark) * ndtr(across / width)
        levels = one.delivered(light) + rng.normal(0, NOISE, light.shape)
        segments = find_segments(
            np.clip(np.rint(levels), 0, 255).astype(np.uint8), response=response
        )
        if len(segments) == 0:
            continue
        longest = int(np.argmax(segments.length_px))
        half = np.concatenate([normal, normal]) / 2
        off = ((np.asarray(segments.endpoints_px)[longest] - middle) @ normal).mean()
        yield off, off / np.sqrt(half @ np.asarray(segments.covariance_px2)[longest] @ half)
