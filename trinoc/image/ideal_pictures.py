"""Pictures as cameras without distortion would have taken them: of one lens, of a rig as it looks,
and of two cameras that are turned until rows correspond.

Maps are those of `cv2.remap`: for each pixel of the new picture the place in the old one, by the
projection of the lens itself, so that every lens model has them.
"""

from collections.abc import Mapping
from typing import NamedTuple, overload

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Shaped

from trinoc.errors import InputError, check_kind, list_names
from trinoc.geometry.ideal_cameras import undistort_lens, undistort_rig
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.picture_window import CAMERA_FRAME
from trinoc.geometry.projection import project_points
from trinoc.geometry.rectification import (
    NOTED_SHARE,
    Disparity,
    rectify_pair,
    share_of_common_field,
)
from trinoc.geometry.rig import A_RIG, Rig
from trinoc.numerics.buckets import blocks
from trinoc.numerics.precision import in_float64

# Where a ray is imaged that the lens does not see.
_NOWHERE_PX = -1e4
_BLOCK = 1 << 16
# Which OpenCV resamples.
_DEPTHS = (np.uint8, np.uint16, np.float32, np.float64)


class PictureMaps(NamedTuple):
    """Where the pixels of a new picture are in an old one, as `cv2.remap` takes it.

    Fields
    ------
    map_x, map_y : (h, w) column and row of each, (0, 0) the centre of the top-left pixel.
    size_px : (width, height) of the old picture.
    """

    map_x: Float32[np.ndarray, "h w"]
    map_y: Float32[np.ndarray, "h w"]
    size_px: tuple[int, int]

    @property
    def valid(self) -> Bool[np.ndarray, "h w"]:
        """(h, w) whether the old picture shows what the pixel shows."""
        width, height = self.size_px
        across = (self.map_x >= -0.5) & (self.map_x <= width - 0.5)
        return across & (self.map_y >= -0.5) & (self.map_y <= height - 0.5)

    def resample(self, picture: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
        """The new picture, of the same depth and channels, 0 where it is not valid.

        Bicubic, which leaves the edges of a picture where they are. Raises InputError for a picture
        of another size.
        """
        given = np.asarray(picture)
        size = given.shape[1::-1] if given.ndim in (2, 3) else given.shape
        if size != self.size_px:
            raise InputError(
                f"The picture is {' x '.join(map(str, size))} px, but the lens is of pictures of "
                f"{self.size_px[0]} x {self.size_px[1]} px: give one of that size."
            )
        if given.dtype not in _DEPTHS:
            raise InputError(
                f"The picture is of {given.dtype}: give one of uint8, uint16, float32 or float64."
            )
        # Values beyond the border are those at it, so that the outermost pixels do not darken.
        made = cv2.remap(
            given, self.map_x, self.map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        ).reshape(*self.map_x.shape, *given.shape[2:])
        made[~self.valid] = 0
        return made


class IdealLens(NamedTuple):
    """lens : without distortion. maps : from pictures of the lens before to its pictures."""

    lens: Intrinsics
    maps: PictureMaps


class IdealRig(NamedTuple):
    """Cameras without distortion, and the way from the pictures of the cameras before to theirs.

    Fields
    ------
    rig : at the same centres; with a covariance where that of the rig before holds for it.
    maps : of each camera.
    disparity : of a rectified pair, from which depth follows.
    notes : sentences on what a rectified pair loses of the field that both cameras see.
    """

    rig: Rig
    maps: dict[str, PictureMaps]
    disparity: Disparity | None = None
    notes: tuple[str, ...] = ()

    def resample(
        self, pictures: Mapping[str, Shaped[np.ndarray, "..."]]
    ) -> dict[str, Shaped[np.ndarray, "..."]]:
        """The new picture of each camera that is given. Raises InputError as `PictureMaps` does."""
        made = {}
        for name, picture in pictures.items():
            if name not in self.maps:
                raise InputError(
                    f'There is no camera "{name}". This rig has {list_names(self.maps)}.'
                )
            made[name] = self.maps[name].resample(picture)
        return made


@overload
def undistort(
    cameras: Intrinsics, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> IdealLens: ...


@overload
def undistort(
    cameras: Rig, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> IdealRig: ...


def undistort(
    cameras: Intrinsics | Rig, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> IdealLens | IdealRig:
    """A lens, or all cameras of a rig, without distortion, and maps for their pictures.

    Parameters
    ----------
    cameras : of any lens model.
    alpha : how much of the field is kept, as in OpenCV: 0 the largest part all of whose pixels are
        valid, 1 all of it (of a fisheye up to 75 degrees from the axis), with black around it.
    image_size_px : (width, height) of the new pictures, by default that of the old ones.

    Pixels keep their shape, cameras their pose. The covariance of a rig stays,
    unless it holds errors of lenses that change, which no ideal lens can have: then there is none.

    Raises InputError for a lens whose distortion folds the picture.
    """
    check_kind(cameras, (Intrinsics, Rig), "lens or rig", "trinoc.Intrinsics or trinoc.Rig")
    if isinstance(cameras, Intrinsics):
        lens = undistort_lens(cameras, alpha=alpha, image_size_px=image_size_px)
        return IdealLens(lens, picture_maps(cameras, lens, np.eye(3)))
    ideal = undistort_rig(cameras, alpha=alpha, image_size_px=image_size_px)
    return IdealRig(ideal, _maps(cameras, ideal))


def rectify(
    rig: Rig, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> IdealRig:
    """Two cameras turned, without distortion, so that a point has one row in both pictures.

    Parameters
    ----------
    rig : of two cameras.
    alpha, image_size_px : as in `undistort`; by default the pictures are as large as the larger.

    `disparity` of the result gives depth: f (C_b - C_a) / ((u_a - c_a) - (u_b - c_b)) for cameras a
    and b with centres C along the rows, the focal length f and the principal points c along u.

    The centres stay. The covariance of the poses is propagated to first order; where the lenses
    are not exact either, there is none.

    Raises InputError where the cameras stand at one place, look along the line of their centres or
    at opposite sides, see each other, have no rows in common, or where less than a tenth of what
    both look at would be left.
    """
    check_kind(rig, Rig, "rig", A_RIG)
    ideal, disparity = rectify_pair(rig, alpha=alpha, image_size_px=image_size_px)
    share, notes = share_of_common_field(rig, dict(ideal.items())), ()
    if share < NOTED_SHARE:
        notes = (
            f"The new pictures show {100 * share:.0f} % of what both cameras look at; a larger "
            "alpha keeps more.",
        )
    return IdealRig(ideal, _maps(rig, ideal), disparity, notes)


def _maps(rig: Rig, ideal: Rig) -> dict[str, PictureMaps]:
    maps = {}
    for name, camera in rig.items():
        turn = np.asarray(camera.pose.rotation) @ np.asarray(ideal[name].pose.rotation).T
        maps[name] = picture_maps(camera.intrinsics, ideal[name].intrinsics, turn)
    return maps


@in_float64
def picture_maps(
    lens: Intrinsics, ideal: Intrinsics, cam_from_ideal: Float[np.ndarray, "3 3"]
) -> PictureMaps:
    """Maps from pictures of a lens to those of an ideal one at the same place.

    `cam_from_ideal` is the rotation from the frame of the ideal camera to that of the other.
    """
    width, height = ideal.image_size_px
    maps = np.empty((2, height, width), np.float32)
    cam_from_pixel = cam_from_ideal @ np.linalg.inv(ideal.matrix)
    # Some rows at a time, so that memory stays that of the maps.
    for rows in blocks(height, max(1, _BLOCK // width)):
        v, u = np.mgrid[rows, :width].reshape(2, -1)
        rays = np.stack([u, v, np.ones_like(u)], axis=1) @ cam_from_pixel.T
        maps[:, rows] = _image_rays(lens, rays).T.reshape(2, -1, width)
    maps.flags.writeable = False
    return PictureMaps(maps[0], maps[1], lens.image_size_px)


def _image_rays(lens: Intrinsics, rays_cam: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Pixels that a lens makes of rays, far from the picture for those that it does not see."""
    uv_px = project_points(CAMERA_FRAME, lens.lens, rays_cam)
    # Beyond its fold a polynomial shows what lies before it a second time.
    fold = np.cos(lens.lens.fold_angle_rad())
    seen = rays_cam[:, 2] > fold * np.linalg.norm(rays_cam, axis=1)
    uv_px = np.where(seen[:, None] & np.isfinite(uv_px), uv_px, _NOWHERE_PX)
    return np.clip(uv_px, _NOWHERE_PX, max(lens.image_size_px) - _NOWHERE_PX)
