"""Window of an undistorted image: its scale, and its position in the ideal image plane.

A window lies inside the field of view of a camera if it contains no point of the field's border.
The largest window about a given centre therefore extends to the nearest border point, in the norm
whose unit ball is the window. `cv2.getOptimalNewCameraMatrix` and `cv2.stereoRectify` use extremes
of the border instead. For convergent or rolled cameras they show a small part of the field, or
invalid pixels.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import FOLD_REMEDY, Intrinsics, describe_unusable_fold
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_points, unproject_pixels

# Largest angle from the axis of an ideal image. Fisheye lenses have wider fields, for which the
# image plane would become too large.
WIDEST_DEG = 75.0
_WIDEST = float(np.tan(np.radians(WIDEST_DEG)))
# Points along each side of a picture.
_STEPS = 32
# Largest error of a round trip pixel - ray - pixel for a distortion that does not fold.
_CLOSES_PX = 1e-3
# The search for the middle repeats a grid about the best point, narrower each time.
_GRID, _ROUNDS, _NARROWER = 11, 14, 0.35
# Between two points a border bends by less than this share of the window.
_BEND = 1e-4
# The camera frame as world frame.
CAMERA_FRAME = Pose(np.eye(3, 4))


class Windows(NamedTuple):
    """Scale and position of several undistorted images in one common image plane.

    A pixel is `scale_px` times the coordinates of the plane plus the origin. The coordinates are
    (x/z, y/z), or these multiplied by a matrix with the ratio of the focal lengths and the skew.

    Attributes
    ----------
    scale_px : float
        Pixels per unit of the plane, equal for all images.
    origins_px : (v, 2)
        Pixel of the plane's origin, the principal point, in each image.
    """

    scale_px: float
    origins_px: Float[np.ndarray, "v 2"]


def border_in_plane(
    lens: Intrinsics, ideal_from_cam: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "m 2"]:
    """Border of an image, once around, in the plane of an undistorted image, (m, 2).

    The coordinates are (x/z, y/z) after the rotation `ideal_from_cam`. If the distortion folds in
    the corners, the border is cut at the fold. Points farther than 75 degrees from the new optical
    axis are moved to that angle.

    Raises
    ------
    InputError
        If the fold leaves too little of the image, or rays and pixels are not one to one.
    """
    fold = describe_unusable_fold(lens)
    if fold is not None:
        raise InputError(f"The distortion of the lens {fold}: {FOLD_REMEDY}")
    border_px = _cut_at_fold(lens, _list_border(lens.image_size_px))
    rays = unproject_pixels(lens.lens, border_px)
    off_px = np.abs(project_points(CAMERA_FRAME, lens.lens, rays) - border_px).max(axis=1)
    shown = rays[:, 2] > np.cos(np.radians(WIDEST_DEG)) * np.linalg.norm(rays, axis=1)
    if not (np.isfinite(rays).all() and (off_px[shown] < _CLOSES_PX).all()):
        raise InputError(
            "The distortion of the lens folds the image inside its border. Check the order and "
            "signs of its coefficients, or fit fewer of them."
        )
    x, y, z = (rays @ ideal_from_cam.T).T
    across = np.maximum(np.hypot(x, y), np.finfo(float).tiny)
    radius = np.where(across <= _WIDEST * z, across / np.where(z > 0, z, 1.0), _WIDEST)
    return np.stack([x, y], axis=1) * (radius / across)[:, None]


def _cut_at_fold(lens: Intrinsics, uv_px: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 2"]:
    """Move points beyond the valid radius of the lens toward the principal point, to that radius.

    Points are (m, 2) in px.
    """
    centre_px = np.asarray(lens.principal_point_px)
    offset = uv_px - centre_px
    away_px = np.maximum(np.linalg.norm(offset, axis=1), np.finfo(float).tiny)
    return centre_px + offset * np.minimum(1.0, lens.valid_radius_px / away_px)[:, None]


def _list_border(size_px: tuple[int, int]) -> Float[np.ndarray, "m 2"]:
    """Centres of pixels on the image border, once around, (m, 2) px."""
    width, height = size_px
    along = np.linspace(0.0, 1.0, _STEPS, endpoint=False)
    rising, falling = along, 1 - along
    zero, one = np.zeros(_STEPS), np.ones(_STEPS)
    u = np.concatenate([rising, one, falling, zero]) * (width - 1)
    v = np.concatenate([zero, rising, one, falling]) * (height - 1)
    return np.stack([u, v], axis=1)


def fit_windows(
    borders: Sequence[Float[np.ndarray, "_ 2"]], size_px: tuple[int, int], alpha: float
) -> Windows | None:
    """Fit windows of equal size and scale to fields of view; None if no pixel can be valid.

    All windows have the same v origin, so that their rows correspond.

    Parameters
    ----------
    borders : sequence of (m, 2)
        Border of the field of view of each camera, once around, in the plane of `Windows`.
    size_px : (width, height)
        Size of every window.
    alpha : float
        Size of the windows. 0: the largest inside the fields, so that all pixels are valid. 1: the
        smallest around the fields. For values between, scale and position are interpolated.

    Returns
    -------
    Windows or None
    """
    half = (np.array(size_px) - 1) / 2
    # In units in which all windows are squares.
    regions = [border / half for border in borders]
    inner = _largest_inside(regions)
    if inner is None:
        return None
    within, around = _windows(*inner, half), _windows(*_smallest_around(regions), half)
    return Windows(
        (1 - alpha) * within.scale_px + alpha * around.scale_px,
        (1 - alpha) * within.origins_px + alpha * around.origins_px,
    )


def _windows(
    half_side: float, centres: Float[np.ndarray, "v 2"], half: Float[np.ndarray, "2"]
) -> Windows:
    return Windows(1 / half_side, half * (1 - centres / half_side))


def _smallest_around(
    regions: Sequence[Float[np.ndarray, "_ 2"]],
) -> tuple[float, Float[np.ndarray, "v 2"]]:
    """Smallest equal squares that contain the regions: (half side, centres (v, 2)).

    All centres have the same y. A region is the border (m, 2) of a field of view, scaled so that
    the windows are squares.
    """
    low = np.stack([region.min(axis=0) for region in regions])
    high = np.stack([region.max(axis=0) for region in regions])
    low[:, 1], high[:, 1] = low[:, 1].min(), high[:, 1].max()
    return float((high - low).max()) / 2, (low + high) / 2


def _largest_inside(
    regions: Sequence[Float[np.ndarray, "_ 2"]],
) -> tuple[float, Float[np.ndarray, "v 2"]] | None:
    """Largest equal squares inside the regions: (half side, centres (v, 2)), or None.

    All centres have the same y. None if no square lies inside every region. Regions are as in
    `_smallest_around`.
    """
    low = np.stack([region.min(axis=0) for region in regions])
    high = np.stack([region.max(axis=0) for region in regions])
    centres, spans = (low + high) / 2, (high - low) / 2
    centres[:, 1], spans[:, 1] = centres[0, 1], spans[0, 1]
    grid, best = np.linspace(-1, 1, _GRID), -np.inf
    for _ in range(_ROUNDS):
        x = centres[:, :1] + spans[:, :1] * grid
        y = centres[0, 1] + spans[0, 1] * grid
        half_sides = np.stack(
            [_half_side_inside(*each, y) for each in zip(regions, x, strict=True)]
        )
        common = np.minimum(half_sides[0], half_sides[1:].max(axis=1).min(axis=0, initial=np.inf))
        column, row = np.unravel_index(np.argmax(common), common.shape)
        if common[column, row] >= best:
            best = common[column, row]
            columns = [column, *half_sides[1:, :, row].argmax(axis=1)]
            centres = np.array([(xs[k], y[row]) for xs, k in zip(x, columns, strict=True)])
        spans = spans * _NARROWER
    return (float(best) * (1 - _BEND), centres) if best > 0 else None


def _half_side_inside(
    region: Float[np.ndarray, "m 2"], x: Float[np.ndarray, "i"], y: Float[np.ndarray, "j"]
) -> Float[np.ndarray, "i j"]:
    """Half side of the largest square inside a region, for each centre (x, y), (i, j).

    `x` and `y` are the coordinates of a grid of i x j centres. The result is negative for a centre
    outside the region.
    """
    centres = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    start = region - centres
    side = np.roll(region, -1, axis=0) - region
    (a, b), (da, db) = np.moveaxis(start, -1, 0), side.T
    # The larger of |a + t da| and |b + t db| is convex in t: it is least where one of them is zero,
    # where both are equal, or at an end.
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = [-a / da, -b / db, (b - a) / (da - db), -(a + b) / (da + db)]
    steps = [np.nan_to_num(np.clip(t, 0, 1)) for t in turns]
    distance = np.full(a.shape, np.inf)
    for t in (np.zeros_like(a), *steps):
        distance = np.minimum(distance, np.maximum(np.abs(a + t * da), np.abs(b + t * db)))
    nearest = distance.min(axis=1)
    inside = _is_inside(a, b, da, db)
    return np.where(inside, nearest, -nearest).reshape(len(x), len(y))


def _is_inside(
    a: Float[np.ndarray, "n m"],
    b: Float[np.ndarray, "n m"],
    da: Float[np.ndarray, "m"],
    db: Float[np.ndarray, "m"],
) -> Bool[np.ndarray, "n"]:
    """Return True for polygons that contain the origin, (n,).

    The n polygons are shifted copies of one polygon. `a` and `b` are x and y of their m corners;
    `da` and `db` are the x and y components of the sides, from each corner to the next. Test: a ray
    from the origin crosses an odd number of sides.
    """
    crosses = (b > 0) != (np.roll(b, -1, axis=1) > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        right = a - b * da / db > 0
    return (crosses & right).sum(axis=1) % 2 == 1
