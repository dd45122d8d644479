"""What all cameras saw of the board in all shots, as arrays of fixed lengths."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.detection import Detection
from trinoc.calib.model import bucket_size, whitening_of_covariance
from trinoc.calib.targets import AbstractTarget
from trinoc.numerics import ArrayLike

# Views and shots are padded to these numbers, so that one more seldom compiles anew.
_FEWEST_VIEWS, FEWEST_SHOTS = 32, 8


class View(NamedTuple):
    """What one camera saw in one shot.

    Fields
    ------
    camera, shot : which; indices.
    detection : the board's places in the picture, labelled in one way.
    used : (m,) which places take part.
    """

    camera: int
    shot: int
    detection: Detection
    used: Bool[np.ndarray, "_m"]


class ViewTable(NamedTuple):
    """Views as arrays; places without whitening, and views of them alone, say nothing.

    Fields
    ------
    camera, shot : (v,) of each view.
    place_mm : (v, n, 2) on the board.
    radius_mm : (v, n) of the circle there; 0 for a corner.
    uv_px : (v, n, 2) centre of its image, or the corner's.
    whitening : (v, n, 2, 2) W, with W^T W the inverse of each covariance; 0 for unused ones.
    """

    camera: Int[ArrayLike, "v"]
    shot: Int[ArrayLike, "v"]
    place_mm: Float[ArrayLike, "v n 2"]
    radius_mm: Float[ArrayLike, "v n"]
    uv_px: Float[ArrayLike, "v n 2"]
    whitening: Float[ArrayLike, "v n 2 2"]


def padded_count(count: int, fewest: int) -> int:
    """The least of 2^k and 3 * 2^k, and of `fewest`, that is not below `count`."""
    power = 1 << max(count - 1, 0).bit_length()
    return max(fewest, 3 * power // 4 if count <= 3 * power // 4 else power)


def view_table(views: Sequence[View], target: AbstractTarget) -> ViewTable:
    """All views, padded."""
    rows = max(bucket_size(max(len(view.detection) for view in views)), 1)
    count = padded_count(len(views), _FEWEST_VIEWS)
    table = ViewTable(
        np.zeros(count, dtype=int),
        np.zeros(count, dtype=int),
        np.zeros((count, rows, 2)),
        np.zeros((count, rows)),
        np.zeros((count, rows, 2)),
        np.zeros((count, rows, 2, 2)),
    )
    for v, view in enumerate(views):
        seen, index = slice(len(view.detection)), view.detection.circle_index
        table.camera[v], table.shot[v] = view.camera, view.shot
        table.place_mm[v, seen] = target.centres_mm[index]
        table.radius_mm[v, seen] = target.radius_mm[index]
        table.uv_px[v, seen] = view.detection.centres_px
        whitening = whitening_of_covariance(view.detection.covariance_px2)
        table.whitening[v, seen] = np.where(view.used[:, None, None], whitening, 0.0)
    return table
