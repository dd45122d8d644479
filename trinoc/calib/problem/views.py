"""Observations of the board in all images of all shots, as arrays of fixed lengths.

A *board point* is a circle centre or a corner of the board.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.detection.detection import Detection
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.numerics.buckets import bucket
from trinoc.numerics.joins import point_tree
from trinoc.numerics.precision import ArrayLike

# numerical: observations and shots are padded to these numbers, so that one more rarely compiles
# again. Few observations, and those of one shot, have smaller sizes to save time.
_FEWEST_VIEWS, FEWEST_SHOTS = 16, 8
# numerical: likewise.
_FEW_VIEWS, _FEWEST_VIEWS_OF_ONE_SHOT, _FEWEST_PLACES = 8, 3, 32
# numerical: largest table with spare rows for grey levels, at no cost in time.
_MOST_WITH_SPARE_ROWS = 128
# numerical: pieces of each half of the two crossed lines in the fit to grey levels.
LINE_PIECES = 8
# numerical: index of a piece of a line, which is no board point; larger than all indices.
NO_POINT = 1 << 30


class SheetPoints(NamedTuple):
    """Points of the sheet with their pixels in one image, fitted to the grey levels.

    Attributes
    ----------
    point_mm : (n, 2) positions on the drawing. If the board moved between the images of a shot: (n,
        3) positions in the frame of the board.
    uv_px : (n, 2) pixels of the points.
    whitening : (2n, 2n) root R of the information R^T R (inverse covariance) of all pixel
        coordinates. The information may be singular; unused rows of R are 0.
    """

    point_mm: Float[np.ndarray, "*v n _d"]
    uv_px: Float[np.ndarray, "*v n 2"]
    whitening: Float[np.ndarray, "*v k k"]


class BoardObservation(NamedTuple):
    """Observation of a board in one image: one camera, one shot.

    A shot is the set of images that all cameras take at one moment.

    Attributes
    ----------
    camera, shot : indices of the camera and the shot.
    detection : detected board points (circle centres or corners), with one assignment to the board.
    used : (m,) whether each detected point is used; outliers are not.
    grey_level_points : points from the fit to the grey levels, used instead of the detected points.
        None are used if `used` is all False.
    board : index of the board in a set.
    ink_spread_mm : distance by which the ink extends beyond the drawn edge of each circle.
    spare_rows : number of empty table rows reserved for a later fit to grey levels, so that both
        fits use one compiled program.
    sigma_ratio : scatter of this image's points divided by that of its camera. The point sigmas are
        multiplied by it.
    has_motion_errors : whether `grey_level_points` are in fact the detected points, with errors
        that the board's motion between the images of a shot correlates.
    """

    camera: int
    shot: int
    detection: Detection
    used: Bool[np.ndarray, "_m"]
    grey_level_points: SheetPoints | None = None
    board: int = 0
    ink_spread_mm: float = 0.0
    spare_rows: int = 0
    sigma_ratio: float = 1.0
    has_motion_errors: bool = False

    def without_motion(self) -> "BoardObservation":
        """Copy in which the motion of the board no longer correlates the errors of the points.

        It uses the detected points with independent errors, so that a board pose can be fitted to
        this image alone. Without motion errors, the observation itself is returned.
        """
        return (
            self._replace(grey_level_points=None, has_motion_errors=False)
            if self.has_motion_errors
            else self
        )

    @property
    def row_count(self) -> int:
        """Number of points of this observation, used or not."""
        points = (
            self.detection.centres_px
            if self.grey_level_points is None
            else self.grey_level_points.point_mm
        )
        return len(points)

    @property
    def rows_used(self) -> Bool[np.ndarray, "_r"]:
        """Mask, (r,), of the points that are used: detected points, or grey-level points if these
        exist.
        """
        if self.grey_level_points is None:
            return self.used
        return np.any(self.grey_level_points.whitening != 0, axis=0)[::2] & self.used.any()

    @property
    def coordinate_count(self) -> int:
        """Number of pixel coordinates of the used points that carry information."""
        if self.grey_level_points is None:
            return 2 * int(self.used.sum())
        return (
            int(np.any(self.grey_level_points.whitening != 0, axis=1).sum())
            if self.used.any()
            else 0
        )


class ObservationTable(NamedTuple):
    """Observations as padded arrays: v observations of n points each.

    Attributes
    ----------
    camera, shot, board : (v,) indices of camera, shot and board of each observation.
    point : (v, n) index of each board point in the target; `NO_POINT` for a piece of a line.
    point_mm : (v, n, 3) position of each point on the drawing.
    radius_mm : (v, n) radius of the circle; 0 for a corner.
    uv_px : (v, n, 2) observed pixel of the corner, or of the centre of the circle's elliptical
        image.
    whitening : (v, g, k, k) matrix W of each of g groups of points; W^T W is the inverse
        covariance. It is 0 for unused points and padding. Shape (v, n, 2, 2) for independent errors
        of the points; (v, 1, 2n, 2n) for correlated errors, as from grey levels.
    """

    camera: Int[ArrayLike, "v"]
    shot: Int[ArrayLike, "v"]
    board: Int[ArrayLike, "v"]
    point: Int[ArrayLike, "v n"]
    point_mm: Float[ArrayLike, "v n 3"]
    radius_mm: Float[ArrayLike, "v n"]
    uv_px: Float[ArrayLike, "v n 2"]
    whitening: Float[ArrayLike, "v g k k"]


def shot_capacity(shots: int) -> int:
    """Padded length of the shot axis for this number of shots."""
    return shots if shots == 1 else pad_count(shots, FEWEST_SHOTS)


def pad_count(count: int, fewest: int) -> int:
    """Round a count up to at least `fewest` and to the form 2^k or 3 * 2^k."""
    power = 1 << max(count - 1, 0).bit_length()
    return max(fewest, 3 * power // 4 if count <= 3 * power // 4 else power)


def observation_table(
    views: Sequence[BoardObservation], target: AbstractTarget
) -> ObservationTable:
    """Convert observations to arrays, padded to few different sizes so that programs rarely compile
    again.
    """
    rows = max(bucket(max(view.row_count for view in views), smallest=_FEWEST_PLACES), 1)
    is_joint = any(view.grey_level_points is not None for view in views)
    wide_rows = bucket(
        max(view.row_count + view.spare_rows for view in views), smallest=_FEWEST_PLACES
    )
    if any(view.spare_rows for view in views) and wide_rows <= _MOST_WITH_SPARE_ROWS:
        rows, is_joint = wide_rows, True
    fewest = _FEW_VIEWS if len(views) <= _FEW_VIEWS else _FEWEST_VIEWS
    if all(view.shot == 0 for view in views):
        fewest = _FEWEST_VIEWS_OF_ONE_SHOT
    count = pad_count(len(views), fewest)
    table = ObservationTable(
        np.zeros(count, dtype=int),
        np.zeros(count, dtype=int),
        np.zeros(count, dtype=int),
        np.full((count, rows), NO_POINT),
        np.zeros((count, rows, 3)),
        np.zeros((count, rows)),
        np.zeros((count, rows, 2)),
        np.zeros((count, 1, 2 * rows, 2 * rows) if is_joint else (count, rows, 2, 2)),
    )
    centres_mm, radius_mm = target.centres_mm, target.radius_mm
    for v, view in enumerate(views):
        table.camera[v], table.shot[v], table.board[v] = view.camera, view.shot, view.board
        filled = slice(view.row_count)
        if view.grey_level_points is not None:
            place_mm = view.grey_level_points.point_mm
            table.point[v, filled] = find_circles(place_mm[:, :2], target)
            table.point_mm[v, filled, : place_mm.shape[1]] = place_mm
            table.uv_px[v, filled] = view.grey_level_points.uv_px
            coordinates = slice(2 * view.row_count)
            table.whitening[v, 0, coordinates, coordinates] = (
                view.grey_level_points.whitening * view.used.any()
            )
            continue
        index = view.detection.circle_index
        table.point[v, filled] = index
        table.point_mm[v, filled, : centres_mm.shape[1]] = centres_mm[index]
        radius = radius_mm[index]
        table.radius_mm[v, filled] = np.where(radius > 0, radius + view.ink_spread_mm, 0.0)
        table.uv_px[v, filled] = view.detection.centres_px
        whitening = whitening_of_covariance(view.detection.covariance_px2)
        whitening = np.where(view.used[:, None, None], whitening, 0.0)
        if is_joint:
            diagonal = np.arange(view.row_count)
            table.whitening[v, 0].reshape(rows, 2, rows, 2)[diagonal, :, diagonal] = whitening
        else:
            table.whitening[v, filled] = whitening
    return table


def find_circles(
    point_mm: Float[np.ndarray, "m 2"], target: AbstractTarget
) -> Int[np.ndarray, "m"]:
    """Index of the circle that contains each position; `NO_POINT` if no circle does.

    On a board of corners: index of the nearest corner.
    """
    distance, nearest = point_tree(target.centres_mm).query(point_mm)
    radius = target.radius_mm[nearest]
    return np.where((distance < radius) | (radius == 0), nearest, NO_POINT)


def whitening_of_covariance(covariance: Float[np.ndarray, "m 2 2"]) -> Float[np.ndarray, "m 2 2"]:
    """Matrix W of each 2 x 2 covariance with W^T W = covariance^-1, (m, 2, 2)."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    first = np.sqrt(a)
    slope = b / first
    second = np.sqrt(c - slope**2)
    whitening = np.zeros_like(covariance)
    whitening[:, 0, 0] = 1 / first
    whitening[:, 1, 0] = -slope / (first * second)
    whitening[:, 1, 1] = 1 / second
    return whitening
