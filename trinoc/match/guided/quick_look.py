"""A quick look at whether a picture may show an edge along a probe: far cheaper than the one test.

The gradient across is read at LOOKS places along, from the nearest pixels, on five lines side by
side. Where most of it goes along the probe, it is that of an edge that crosses, and does not count;
and one place counts no more than a few standard deviations, so that many must agree.
"""

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.match.guided.ridges import REACH
from trinoc.match.guided.views import PictureInput
from trinoc.match.observations import distorted

LOOKS = 16
# One place counts so many standard deviations of noise at most.
_MOST = 3.0
# Probes at once; OpenCV takes 32,766 rows at most.
_AT_ONCE = 2048
# Lines are drawn with their ends in so many binary digits of a pixel.
_DIGITS = 4


def quick_look(
    picture: PictureInput, ends_px: Float[np.ndarray, "n 2 2"]
) -> Float[np.ndarray, "n"]:
    """Mean of the gradient across along the better half of each probe, in standard deviations of
    its noise; without sign, 0 to 3."""
    found = np.zeros(len(ends_px))
    for start in range(0, len(ends_px), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        found[rows] = _looked_at(picture, ends_px[rows])
    return found


def _looked_at(
    picture: PictureInput, ends_px: Float[np.ndarray, "n 2 2"]
) -> Float[np.ndarray, "n"]:
    ends_px = distorted(picture.lens, ends_px)
    way = ends_px[:, 1] - ends_px[:, 0]
    unit = way / np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    along, beside = (np.arange(LOOKS) + 0.5) / LOOKS, np.arange(-REACH, REACH + 1)
    u, v = (
        (start[:, None] + along * step[:, None])[:, None] + beside[:, None] * side[:, None, None]
        for start, step, side in zip(ends_px[:, 0].T, way.T, right.T, strict=True)
    )
    u, v = (place.reshape(len(way), LOOKS * len(beside)).astype(np.float32) for place in (u, v))
    found = cv2.remap(picture.by_uv, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    noise = max(picture.noise, 1e-3)
    across, crossing = (
        (found @ (side / noise).astype(np.float32)[:, :, None])[..., 0] for side in (right, unit)
    )
    across = np.where(np.abs(crossing) < np.abs(across), np.clip(across, -_MOST, _MOST), 0.0)
    quarters = across.reshape(len(way), len(beside), 4, LOOKS // 4).sum(axis=3)
    halves = np.abs(quarters[..., :-1] + quarters[..., 1:])
    return halves.max(axis=(1, 2), initial=0.0) / (LOOKS // 2)


def without(
    picture: PictureInput, ends_px: Float[np.ndarray, "n 2 2"], width_px: int
) -> PictureInput:
    """The picture with no gradient on these segments: what is left is new."""
    by_uv = picture.by_uv.copy()
    places = np.rint(distorted(picture.lens, ends_px) * 2**_DIGITS).astype(np.int32)
    cv2.polylines(by_uv, list(places), False, (0.0, 0.0), width_px, cv2.LINE_8, _DIGITS)
    return picture._replace(by_uv=by_uv)
