"""Undistorted and rectified images: of one lens, of a rig, of two cameras with common rows.

Maps have the format of `cv2.remap`: for each pixel of the new image, its position in the old one.
They come from the projection of the lens, so they exist for every lens model.
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

# Coordinate of rays that the lens does not image.
_NOWHERE_PX = -1e4
_BLOCK = 1 << 16
# Types that OpenCV resamples.
_DEPTHS = (np.uint8, np.uint16, np.float32, np.float64)


class PictureMaps(NamedTuple):
    """Maps for `cv2.remap`: for each pixel of a new image, its position in the old image.

    Attributes
    ----------
    map_x, map_y : (h, w)
        Column and row in the old image for each pixel of the new image, px; (0, 0) is the centre of
        the top-left pixel.
    size_px : (width, height)
        Size of the old image.
    """

    map_x: Float32[np.ndarray, "h w"]
    map_y: Float32[np.ndarray, "h w"]
    size_px: tuple[int, int]

    @property
    def valid(self) -> Bool[np.ndarray, "h w"]:
        """Mask of the pixels of the new image that lie inside the old image, (h, w)."""
        width, height = self.size_px
        across = (self.map_x >= -0.5) & (self.map_x <= width - 0.5)
        return across & (self.map_y >= -0.5) & (self.map_y <= height - 0.5)

    def resample(self, picture: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
        """Compute the new image by bicubic interpolation.

        Parameters
        ----------
        picture : (h, w) or (h, w, channels)
            Old image of type uint8, uint16, float32 or float64.

        Returns
        -------
        (h, w) or (h, w, channels)
            New image of the same type; 0 where `valid` is False.

        Raises
        ------
        InputError
            If the image has another size or type.
        """
        array = np.asarray(picture)
        size = array.shape[1::-1] if array.ndim in (2, 3) else array.shape
        if size != self.size_px:
            raise InputError(
                f"The picture is {' x '.join(map(str, size))} px, but the lens belongs to pictures "
                f"of {self.size_px[0]} x {self.size_px[1]} px. Give one of that size."
            )
        if array.dtype not in _DEPTHS:
            raise InputError(
                f"The picture has type {array.dtype}, which cannot be resampled. Give uint8, "
                "uint16, float32 or float64."
            )
        # Replicated border values keep the outermost pixels from darkening.
        resampled = cv2.remap(
            array, self.map_x, self.map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        ).reshape(*self.map_x.shape, *array.shape[2:])
        resampled[~self.valid] = 0
        return resampled


class IdealLens(NamedTuple):
    """A lens without distortion, with maps that convert images of the real lens.

    Attributes
    ----------
    lens : Intrinsics
        The lens without distortion.
    maps : PictureMaps
        Maps from images of the real lens to images of this lens.
    """

    lens: Intrinsics
    maps: PictureMaps


class IdealRig(NamedTuple):
    """Cameras without distortion, with maps that convert images of the real cameras.

    Attributes
    ----------
    rig : Rig
        Cameras without distortion at the centres of the real cameras. The covariance is empty if
        the covariance of the real rig does not apply.
    maps : dict of PictureMaps
        Maps of each camera.
    disparity : Disparity or None
        Conversion from disparity to depth, for a rectified pair.
    notes : tuple of str
        Sentences on the loss of common field of view in a rectified pair.
    """

    rig: Rig
    maps: dict[str, PictureMaps]
    disparity: Disparity | None = None
    notes: tuple[str, ...] = ()

    def resample(
        self, pictures: Mapping[str, Shaped[np.ndarray, "..."]]
    ) -> dict[str, Shaped[np.ndarray, "..."]]:
        """Convert images of the real cameras to images without distortion.

        Parameters
        ----------
        pictures : mapping of str to (h, w) or (h, w, channels)
            Image of each camera, by name.

        Returns
        -------
        dict of str to (h, w) or (h, w, channels)
            New image of each camera.

        Raises
        ------
        InputError
            If the rig has no camera of this name, or an image has the wrong size or type.
        """
        resampled = {}
        for name, picture in pictures.items():
            if name not in self.maps:
                raise InputError(
                    f'There is no camera "{name}". This rig has {list_names(self.maps)}.'
                )
            resampled[name] = self.maps[name].resample(picture)
        return resampled


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
    """Return a lens or a rig without distortion, with maps that convert its images.

    Parameters
    ----------
    cameras : Intrinsics or Rig
        Lens or rig with any lens model.
    alpha : float
        Part of the field of view that is used, as in OpenCV. 0: the largest part in which all
        pixels are valid. 1: the whole field of view (up to 75 degrees from the axis), with a black
        border.
    image_size_px : (width, height), optional
        Size of the new images. Default: the size of the old images.

    Returns
    -------
    IdealLens or IdealRig
        Pixel shapes and poses do not change. The covariance of a rig stays, unless it contains
        errors of a lens that changes, because a pinhole lens does not have these parameters.

    Raises
    ------
    InputError
        If the distortion of a lens folds the image: two rays have the same pixel.
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
    """Rotate two cameras without distortion so that a point has the same row in both images.

    Parameters
    ----------
    rig : Rig
        Two cameras.
    alpha, image_size_px :
        As in `undistort`. Default size: the larger width and the larger height of the two images.

    Returns
    -------
    IdealRig
        Rectified cameras with the same centres, maps and `disparity`. The covariance of the poses
        is propagated to first order. It is empty if the lenses have errors.

    Raises
    ------
    InputError
        If the cameras have the same centre, or look along their baseline or in opposite directions.
        If one camera is in the image of the other, or the images have no common rows. If less than
        a tenth of the common field of view would remain.

    Notes
    -----
    Depth is f (C_b - C_a) / ((u_a - c_a) - (u_b - c_b)) for cameras a and b. C is the centre along
    the rows, f the focal length, c the principal point along u.
    """
    check_kind(rig, Rig, "rig", A_RIG)
    ideal, disparity = rectify_pair(rig, alpha=alpha, image_size_px=image_size_px)
    share, notes = share_of_common_field(rig, dict(ideal.items())), ()
    if share < NOTED_SHARE:
        notes = (
            f"The new pictures show {100 * share:.0f} % of the common field. A larger alpha keeps "
            "more.",
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
    """Maps that convert images of a lens to images of an ideal lens with the same centre.

    Parameters
    ----------
    lens : Intrinsics
        Real lens.
    ideal : Intrinsics
        Lens without distortion.
    cam_from_ideal : (3, 3)
        Rotation from the ideal camera frame to the real camera frame.

    Returns
    -------
    PictureMaps
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
    """Pixels of rays through a lens, (n, 2).

    A ray that the lens does not image has the coordinates _NOWHERE_PX, far outside the image.
    """
    uv_px = project_points(CAMERA_FRAME, lens.lens, rays_cam)
    # Beyond the fold, a polynomial images rays a second time into the valid part.
    fold = np.cos(lens.lens.fold_angle_rad())
    is_before_fold = rays_cam[:, 2] > fold * np.linalg.norm(rays_cam, axis=1)
    uv_px = np.where(is_before_fold[:, None] & np.isfinite(uv_px), uv_px, _NOWHERE_PX)
    return np.clip(uv_px, _NOWHERE_PX, max(lens.image_size_px) - _NOWHERE_PX)
