"""What all cameras saw of the board in all shots, as arrays of fixed lengths."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.detection.detection import Detection
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.numerics.buckets import bucket
from trinoc.numerics.joins import point_tree
from trinoc.numerics.precision import ArrayLike

# numerical: views and shots are padded to these numbers, so that one more seldom compiles anew; few
# views, as of one camera that looks for its lens, and those of one shot to fewer, for their time.
_FEWEST_VIEWS, FEWEST_SHOTS = 16, 8
# numerical: likewise.
_FEW_VIEWS, _FEWEST_VIEWS_OF_ONE_SHOT, _FEWEST_PLACES = 8, 3, 32
# numerical: up to so many places a table may have room for what the pictures show, at no cost in
# time.
_MOST_WITH_ROOM = 128
# numerical: the grey levels show each half of the two crossed lines in so many pieces.
LINE_PIECES = 8
# numerical: the index of what is no place of the target: beyond all of them.
NO_PLACE = 1 << 30


class SheetPoints(NamedTuple):
    """Places of the sheet and the pixels at which one picture shows them.

    Fields
    ------
    place_mm : (n, 2) on the drawing of the sheet, or (n, 3) where the board has moved.
    uv_px : (n, 2) where the picture shows them.
    whitening : (2n, 2n) R, of all their errors as one vector: R^T R is their information, which
        may be singular. Rows of zeros say nothing.
    """

    place_mm: Float[np.ndarray, "*v n _d"]
    uv_px: Float[np.ndarray, "*v n 2"]
    whitening: Float[np.ndarray, "*v k k"]


class View(NamedTuple):
    """What one camera saw in one shot.

    Fields
    ------
    camera, shot : which; indices.
    detection : the board's places in the picture, labelled in one way.
    used : (m,) which places take part.
    shown : where the grey levels show the board, which then counts instead of the detection, as a
        whole unless no place is used.
    board : which of several boards it shows.
    ink_spread_mm : by which ink reaches beyond the drawing of each circle.
    sigma_ratio : scatter of the image's places over that of its camera, by which their sigmas are
        multiplied.
    is_moved : whether `shown` has the detected places with errors that the motion of the board
        between the moments of a shot correlates.
    room : how many places more its grey levels may show, later: a table with room for them lets
        both be fitted by one program.
    """

    camera: int
    shot: int
    detection: Detection
    used: Bool[np.ndarray, "_m"]
    shown: SheetPoints | None = None
    board: int = 0
    ink_spread_mm: float = 0.0
    room: int = 0
    sigma_ratio: float = 1.0
    is_moved: bool = False

    def without_motion(self) -> "View":
        """The view with independent errors of its detected places, for a pose of its own."""
        return self._replace(shown=None, is_moved=False) if self.is_moved else self

    @property
    def rows(self) -> int:
        """How many places stand for this view in the table."""
        places = self.detection.centres_px if self.shown is None else self.shown.place_mm
        return len(places)

    @property
    def kept(self) -> Bool[np.ndarray, "_r"]:
        """Which of the rows take part."""
        if self.shown is None:
            return self.used
        return np.any(self.shown.whitening != 0, axis=0)[::2] & self.used.any()

    @property
    def numbers(self) -> int:
        """How many numbers the places that take part report."""
        if self.shown is None:
            return 2 * int(self.used.sum())
        return int(np.any(self.shown.whitening != 0, axis=1).sum()) if self.used.any() else 0


class ViewTable(NamedTuple):
    """Views as arrays; places without whitening, and views of them alone, say nothing.

    Fields
    ------
    camera, shot, board : (v,) of each view.
    place : (v, n) index of each in the target; `NO_PLACE` for pieces of lines.
    place_mm : (v, n, 3) on the board.
    radius_mm : (v, n) of the circle there; 0 for a corner.
    uv_px : (v, n, 2) centre of its image, or the corner's.
    whitening : (v, g, k, k) W, with W^T W the inverse covariance of each of g groups of places, 0
        for unused ones: of (n, 2, 2) where errors of places share nothing, of (1, 2n, 2n) where
        they do, as those that one picture's grey levels show.
    """

    camera: Int[ArrayLike, "v"]
    shot: Int[ArrayLike, "v"]
    board: Int[ArrayLike, "v"]
    place: Int[ArrayLike, "v n"]
    place_mm: Float[ArrayLike, "v n 3"]
    radius_mm: Float[ArrayLike, "v n"]
    uv_px: Float[ArrayLike, "v n 2"]
    whitening: Float[ArrayLike, "v g k k"]


def shot_capacity(shots: int) -> int:
    """How many shots a state has room for."""
    return shots if shots == 1 else pad_count(shots, FEWEST_SHOTS)


def pad_count(count: int, fewest: int) -> int:
    """The least of 2^k and 3 * 2^k, and of `fewest`, that is not below `count`."""
    power = 1 << max(count - 1, 0).bit_length()
    return max(fewest, 3 * power // 4 if count <= 3 * power // 4 else power)


def view_table(views: Sequence[View], target: AbstractTarget) -> ViewTable:
    """Convert views to arrays, padded to a few sizes so that programs are compiled once."""
    rows = max(bucket(max(view.rows for view in views), smallest=_FEWEST_PLACES), 1)
    shared = any(view.shown is not None for view in views)
    wide = bucket(max(view.rows + view.room for view in views), smallest=_FEWEST_PLACES)
    if any(view.room for view in views) and wide <= _MOST_WITH_ROOM:
        rows, shared = wide, True
    fewest = _FEW_VIEWS if len(views) <= _FEW_VIEWS else _FEWEST_VIEWS
    if all(view.shot == 0 for view in views):
        fewest = _FEWEST_VIEWS_OF_ONE_SHOT
    count = pad_count(len(views), fewest)
    table = ViewTable(
        np.zeros(count, dtype=int),
        np.zeros(count, dtype=int),
        np.zeros(count, dtype=int),
        np.full((count, rows), NO_PLACE),
        np.zeros((count, rows, 3)),
        np.zeros((count, rows)),
        np.zeros((count, rows, 2)),
        np.zeros((count, 1, 2 * rows, 2 * rows) if shared else (count, rows, 2, 2)),
    )
    centres_mm, radius_mm = target.centres_mm, target.radius_mm
    for v, view in enumerate(views):
        table.camera[v], table.shot[v], table.board[v] = view.camera, view.shot, view.board
        filled = slice(view.rows)
        if view.shown is not None:
            place_mm = view.shown.place_mm
            table.place[v, filled] = find_circles(place_mm[:, :2], target)
            table.place_mm[v, filled, : place_mm.shape[1]] = place_mm
            table.uv_px[v, filled] = view.shown.uv_px
            numbers = slice(2 * view.rows)
            table.whitening[v, 0, numbers, numbers] = view.shown.whitening * view.used.any()
            continue
        index = view.detection.circle_index
        table.place[v, filled] = index
        table.place_mm[v, filled, : centres_mm.shape[1]] = centres_mm[index]
        radius = radius_mm[index]
        table.radius_mm[v, filled] = np.where(radius > 0, radius + view.ink_spread_mm, 0.0)
        table.uv_px[v, filled] = view.detection.centres_px
        whitening = whitening_of_covariance(view.detection.covariance_px2)
        whitening = np.where(view.used[:, None, None], whitening, 0.0)
        if shared:
            at = np.arange(view.rows)
            table.whitening[v, 0].reshape(rows, 2, rows, 2)[at, :, at] = whitening
        else:
            table.whitening[v, filled] = whitening
    return table


def find_circles(
    place_mm: Float[np.ndarray, "m 2"], target: AbstractTarget
) -> Int[np.ndarray, "m"]:
    """The circle in which each place lies, or the nearest corner; a piece of a line has none."""
    away, nearest = point_tree(target.centres_mm).query(place_mm)
    radius = target.radius_mm[nearest]
    return np.where((away < radius) | (radius == 0), nearest, NO_PLACE)


def whitening_of_covariance(covariance: Float[np.ndarray, "m 2 2"]) -> Float[np.ndarray, "m 2 2"]:
    """W with W^T W the inverse of each covariance, in closed form."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    first = np.sqrt(a)
    slope = b / first
    second = np.sqrt(c - slope**2)
    whitening = np.zeros_like(covariance)
    whitening[:, 0, 0] = 1 / first
    whitening[:, 1, 0] = -slope / (first * second)
    whitening[:, 1, 1] = 1 / second
    return whitening
