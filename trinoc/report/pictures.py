"""Images as text that a page can hold, and the geometry of drawings over them."""

import base64
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.report.numbers import plain, round_scale

# The page shows a picture at some 1200 dots at most; more would only make it heavy.
LONGEST_SIDE_PX = 1600
JPEG_QUALITY = 88
WINDOW_MARGIN = 1.25


class PagePicture(NamedTuple):
    """Image that the page contains.

    Attributes
    ----------
    key : str
        Identifier on the page.
    width_px, height_px : int
        Size of the original image.
    uri : str
        Data URI of the image; "" if only its size is known.
    """

    key: str
    width_px: int
    height_px: int
    uri: str

    @property
    def window(self) -> "Window":
        """Window of the whole image, from -0.5 px."""
        return Window(-0.5, -0.5, self.width_px, self.height_px)


class Window(NamedTuple):
    """Rectangle of an image that a figure shows, in px."""

    left: float
    top: float
    width: float
    height: float

    @property
    def unit(self) -> float:
        """Unit of length for text and marks in the figure: 1/512 of the width, px."""
        return self.width / 512

    @classmethod
    def around(cls, points_px: Float[np.ndarray, "n 2"], picture: PagePicture) -> "Window":
        """Window around points (n, 2) px with a margin, clipped to the image.

        It has the aspect ratio of the image. Without points it is the whole image.
        """
        if len(points_px) == 0:
            return cls(*picture.window)
        size = np.array([picture.width_px, picture.height_px])
        low, high = points_px.min(axis=0), points_px.max(axis=0)
        share = min(1.0, WINDOW_MARGIN * float(np.max((high - low) / size)))
        extent = share * size
        corner = np.clip((low + high) / 2 - extent / 2, -0.5, size - 0.5 - extent)
        return cls(*corner.tolist(), *extent.tolist())


class Arrows(NamedTuple):
    """Scale of residual arrows.

    Attributes
    ----------
    times : float
        Magnification of the residuals.
    key_px : float
        Length of the residual whose arrow the legend of the figure shows, px.
    """

    times: float
    key_px: float

    @classmethod
    def reaching(cls, longest: Sequence[tuple[float, float]]) -> "Arrows":
        """Common scale for several images, so that their arrows can be compared.

        longest : for each image its longest residual and the longest arrow that it can show, px.
        """
        share = max((residual / reach for residual, reach in longest), default=0.0)
        times = round_scale(1 / share) if share > 1e-12 else 1.0
        reach = min((reach for _, reach in longest), default=1.0)
        return cls(times, round_scale(0.7 * reach / times))

    @property
    def texts(self) -> tuple[str, str]:
        """Magnification, and length of the legend's residual, as text."""
        return plain(self.times), plain(self.key_px)

    def tip(self, point: tuple[float, float], residual: tuple[float, float]) -> tuple[float, float]:
        """Tip of the arrow of a residual (du, dv) at a point (u, v), px."""
        (u, v), (du, dv) = point, residual
        return float(u + self.times * du), float(v + self.times * dv)


def page_picture(
    key: str,
    picture: np.ndarray | None,
    size_px: tuple[int, int],
    *,
    longest_side_px: int = LONGEST_SIDE_PX,
    quality: int = JPEG_QUALITY,
) -> PagePicture:
    """Encode an image of any range as a JPEG data URI.

    Images of 8 bits keep their grey levels; others are stretched to the range that they use.

    key : identifier on the page. picture : (h, w) or (h, w, 3); None if only the size is known.
    size_px : width and height of the original. longest_side_px : limit of the encoded image's
        sides.
    """
    if picture is None:
        return PagePicture(key, *size_px, "")
    array = np.asarray(picture)
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] not in (1, 3, 4)):
        raise InputError(
            f'The picture "{key}" has shape {array.shape}, but must be (rows, columns) or '
            "(rows, columns, channels)."
        )
    height, width = array.shape[:2]
    if array.dtype != np.uint8:
        array = _stretch_levels(array.astype(np.float64))
    if array.ndim == 3:
        array = array[..., 0] if array.shape[2] == 1 else array[..., 2::-1]
    shrink = longest_side_px / max(width, height)
    if shrink < 1:
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        array = cv2.resize(array, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(array), [cv2.IMWRITE_JPEG_QUALITY, quality])
    text = base64.b64encode(data.tobytes()).decode("ascii")
    return PagePicture(key, width, height, f"data:image/jpeg;base64,{text}")


def page_pictures(
    prefix: str,
    pictures: Mapping[str, np.ndarray] | None,
    sizes_px: Mapping[str, tuple[int, int]],
) -> dict[str, PagePicture]:
    """Encode an image for each view. prefix : start of the identifiers, which contain no view
    names.
    """
    images = pictures or {}
    return {
        name: page_picture(f"{prefix}-{number}", images.get(name), size)
        for number, (name, size) in enumerate(sizes_px.items())
    }


def _stretch_levels(array: np.ndarray) -> np.ndarray:
    low, high = float(np.nanmin(array)), float(np.nanmax(array))
    scaled = (array - low) * (255.0 / (high - low)) if high > low else np.zeros_like(array)
    return np.nan_to_num(scaled).round().astype(np.uint8)


def clip_line(
    line: Float[np.ndarray, "3"], size_px: tuple[int, int]
) -> Float[np.ndarray, "2 2"] | None:
    """Ends (2, 2) px of the part of a line inside an image; None if the line misses the image.

    line : (a, b, c) with a u + b v + c = 0.
    """
    if not np.isfinite(line).all():
        return None
    a, b, c = line
    foot = -c * np.array([a, b]) / (a * a + b * b)
    direction = np.array([-b, a]) / np.hypot(a, b)
    low, high = np.full(2, -0.5), np.array(size_px) - 0.5
    # A line along an axis never crosses two of the sides: it is inside them or outside.
    along = np.abs(direction) < 1e-12
    step = np.where(along, 1.0, direction)
    crossings = np.stack([(low - foot) / step, (high - foot) / step])
    inside = (foot >= low) & (foot <= high)
    entry = np.where(along, np.where(inside, -np.inf, np.inf), crossings.min(axis=0)).max()
    leave = np.where(along, np.where(inside, np.inf, -np.inf), crossings.max(axis=0)).min()
    if not entry < leave:
        return None
    return np.stack([foot + entry * direction, foot + leave * direction])
