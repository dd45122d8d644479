"""Window of a picture without distortion: its scale, and its position in the ideal image plane.

A window lies in the region that a camera sees if no point of the region's border lies in it. So the
largest window about a given middle reaches to the nearest point of the border, in the norm whose
unit ball is the window. `cv2.getOptimalNewCameraMatrix` and `cv2.stereoRectify` take extremes of
the border instead: for cameras that converge or are turned about their axes, the second shows a
small part of the field, or pixels that no camera saw.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import FOLD_REMEDY, Intrinsics, describe_unusable_fold
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_points, unproject_pixels

# Largest angle from the axis of an ideal picture: fisheye lenses see farther, where the image plane
# grows beyond all bounds.
WIDEST_DEG = 75.0
_WIDEST = float(np.tan(np.radians(WIDEST_DEG)))
# Points along each side of a picture.
_STEPS = 32
# What a distortion that does not fold loses of a pixel on the way there and back.
_CLOSES_PX = 1e-3
# Grids about the best middle so far, each so much narrower than the one before.
_GRID, _ROUNDS, _NARROWER = 11, 14, 0.35
# Between two points a border bends by less than this share of the window.
_BEND = 1e-4
# A camera in its own frame.
_OWN_FRAME = Pose(np.eye(3, 4))


class Windows(NamedTuple):
    """Windows of pictures in one image plane.

    Fields
    ------
    scale_px : pixels per unit of the plane, the same in all pictures.
    origins_px : (v, 2) pixel coordinates of the plane's origin.
    """

    scale_px: float
    origins_px: Float[np.ndarray, "v 2"]


def border_in_plane(
    lens: Intrinsics, ideal_from_cam: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "m 2"]:
    """Ideal coordinates (x/z, y/z) of the picture's border, once around.

    Where the distortion folds in the corners, the border of what lies before the fold. Points
    farther than WIDEST_DEG from the ideal camera's axis are moved to that angle. Raises InputError
    for a fold that leaves too little of the picture.
    """
    fold = describe_unusable_fold(lens)
    if fold is not None:
        raise InputError(f"The distortion of the lens {fold}: {FOLD_REMEDY}")
    border_px = _cut_at_fold(lens, _list_border(lens.image_size_px))
    rays = unproject_pixels(lens.lens, border_px)
    off_px = np.abs(project_points(_OWN_FRAME, lens.lens, rays) - border_px).max(axis=1)
    shown = rays[:, 2] > np.cos(np.radians(WIDEST_DEG)) * np.linalg.norm(rays, axis=1)
    if not (np.isfinite(rays).all() and (off_px[shown] < _CLOSES_PX).all()):
        raise InputError(
            "The distortion of the lens folds the picture before its border: check the "
            "coefficients, their order and signs, or fit fewer of them."
        )
    x, y, z = (rays @ ideal_from_cam.T).T
    across = np.maximum(np.hypot(x, y), np.finfo(float).tiny)
    reach = np.where(across <= _WIDEST * z, across / np.where(z > 0, z, 1.0), _WIDEST)
    return np.stack([x, y], axis=1) * (reach / across)[:, None]


def _cut_at_fold(lens: Intrinsics, uv_px: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 2"]:
    """Points moved toward the principal point where they lie beyond the lens's valid radius."""
    centre_px = np.asarray(lens.principal_point_px)
    offset = uv_px - centre_px
    away_px = np.maximum(np.linalg.norm(offset, axis=1), np.finfo(float).tiny)
    return centre_px + offset * np.minimum(1.0, lens.valid_radius_px / away_px)[:, None]


def _list_border(size_px: tuple[int, int]) -> Float[np.ndarray, "m 2"]:
    """The centres of the outermost pixels, once around."""
    width, height = size_px
    along = np.linspace(0.0, 1.0, _STEPS, endpoint=False)
    there, back = along, 1 - along
    zero, one = np.zeros(_STEPS), np.ones(_STEPS)
    u = np.concatenate([there, one, back, zero]) * (width - 1)
    v = np.concatenate([zero, there, one, back]) * (height - 1)
    return np.stack([u, v], axis=1)


def fit_windows(
    borders: Sequence[Float[np.ndarray, "_ 2"]], size_px: tuple[int, int], alpha: float
) -> Windows | None:
    """Windows of one size and scale with equal rows; None where no valid pixel is possible.

    borders : of the region that each camera sees, once around.
    alpha : 0 for the largest windows inside the regions, so that all pixels are valid; 1 for the
        smallest windows around them. Scale and position are interpolated between.
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
    reach: float, middles: Float[np.ndarray, "v 2"], half: Float[np.ndarray, "2"]
) -> Windows:
    return Windows(1 / reach, half * (1 - middles / reach))


def _smallest_around(
    regions: Sequence[Float[np.ndarray, "_ 2"]],
) -> tuple[float, Float[np.ndarray, "v 2"]]:
    """(half a side, middles) of the smallest squares around the regions."""
    low = np.stack([region.min(axis=0) for region in regions])
    high = np.stack([region.max(axis=0) for region in regions])
    low[:, 1], high[:, 1] = low[:, 1].min(), high[:, 1].max()
    return float((high - low).max()) / 2, (low + high) / 2


def _largest_inside(
    regions: Sequence[Float[np.ndarray, "_ 2"]],
) -> tuple[float, Float[np.ndarray, "v 2"]] | None:
    """(half a side, middles) of the largest squares inside the regions, or None."""
    low = np.stack([region.min(axis=0) for region in regions])
    high = np.stack([region.max(axis=0) for region in regions])
    middles, spans = (low + high) / 2, (high - low) / 2
    middles[:, 1], spans[:, 1] = middles[0, 1], spans[0, 1]
    grid, best = np.linspace(-1, 1, _GRID), -np.inf
    for _ in range(_ROUNDS):
        x = middles[:, :1] + spans[:, :1] * grid
        y = middles[0, 1] + spans[0, 1] * grid
        reaches = np.stack([_reach_inside(*each, y) for each in zip(regions, x, strict=True)])
        common = np.minimum(reaches[0], reaches[1:].max(axis=1).min(axis=0, initial=np.inf))
        column, row = np.unravel_index(np.argmax(common), common.shape)
        if common[column, row] >= best:
            best = common[column, row]
            columns = [column, *reaches[1:, :, row].argmax(axis=1)]
            middles = np.array([(own[k], y[row]) for own, k in zip(x, columns, strict=True)])
        spans = spans * _NARROWER
    return (float(best) * (1 - _BEND), middles) if best > 0 else None


def _reach_inside(
    region: Float[np.ndarray, "m 2"], x: Float[np.ndarray, "i"], y: Float[np.ndarray, "j"]
) -> Float[np.ndarray, "i j"]:
    """Half a side of the largest square in a region about each (x, y); negative outside of it."""
    middles = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    start = region - middles
    way = np.roll(region, -1, axis=0) - region
    (a, b), (da, db) = np.moveaxis(start, -1, 0), way.T
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
    """Whether the origin is in a polygon: a ray from it crosses an odd number of sides."""
    crosses = (b > 0) != (np.roll(b, -1, axis=1) > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        right = a - b * da / db > 0
    return (crosses & right).sum(axis=1) % 2 == 1
