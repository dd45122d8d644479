"""Replacement of real cameras by distortion-free ones: lenses, poses and covariance.

Stereo rectification (`rectification.py`) and undistorted images (`image/ideal_pictures.py`) use
these cameras.
"""

import contextlib
from collections.abc import Iterator, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from trinoc.errors import InputError, real_number
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics, whole_size_px
from trinoc.geometry.picture_window import border_in_plane, fit_windows
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.programs import kept_jit


@in_float64
def undistort_lens(
    lens: Intrinsics, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> Intrinsics:
    """Return the lens of an undistorted version of the images: a pinhole lens.

    Parameters
    ----------
    lens : Intrinsics
        The real lens, with or without distortion.
    alpha : float
        Part of the field of view that the new image shows. 0: the largest window in which all
        pixels are valid. 1: the whole field, up to 75 degrees from the axis. Values between
        interpolate.
    image_size_px : (width, height), optional
        Size of the new images. Default: the size of the images of `lens`.

    Returns
    -------
    Intrinsics
        A pinhole lens with the skew and the ratio of focal lengths of `lens`. A lens without
        distortion is returned unchanged, unless the size changes.

    Raises
    ------
    InputError
        If the distortion folds the image, or if no pixel can be valid.
    """
    expect_alpha(alpha)
    size_px = lens.image_size_px if image_size_px is None else whole_size_px(image_size_px)
    if not lens.has_distortion and size_px == lens.image_size_px:
        return lens
    shape = np.asarray(lens.matrix[:2, :2] / lens.matrix[0, 0])
    border = border_in_plane(lens, np.eye(3)) @ shape.T
    windows = fit_windows([border], size_px, alpha)
    if windows is None:
        raise InputError(
            "No part of the image can be shown without distortion. Check the coefficients of the "
            "lens."
        )
    return ideal_lens(shape, windows.scale_px, windows.origins_px[0], size_px)


def expect_alpha(alpha: float) -> None:
    """Raise `InputError` if `alpha` is not between 0 and 1."""
    if not 0 <= real_number(alpha, "alpha") <= 1:
        raise InputError(
            f"alpha is {alpha:g}, but must be between 0 and 1. Give 0 for valid pixels only, 1 for "
            "the whole field."
        )


def ideal_lens(
    shape: Float[np.ndarray, "2 2"],
    scale_px: float,
    origin_px: Float[np.ndarray, "2"],
    size_px: tuple[int, int],
) -> Intrinsics:
    """Pinhole lens whose calibration matrix has the upper rows [scale_px * shape | origin_px].

    Parameters
    ----------
    shape : (2, 2)
        Left upper part of the calibration matrix divided by its first entry.
    scale_px : float
        Focal length along u.
    origin_px : (2,)
        Principal point.
    size_px : (width, height)
        Size of the images.
    """
    matrix = np.eye(3)
    matrix[:2] = np.column_stack([scale_px * shape, origin_px])
    return Intrinsics.from_matrix(matrix, size_px)


@in_float64
def undistort_rig(
    rig: Rig, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> Rig:
    """Return the rig with distortion-free lenses; the poses stay the same.

    Parameters
    ----------
    rig : Rig
        Cameras with or without distortion.
    alpha, image_size_px :
        As in `undistort_lens`, for every camera.

    Returns
    -------
    Rig
        Cameras with pinhole lenses, and the covariance of `rig`. The covariance is empty if it
        contains lens parameters of a camera whose lens changes: a pinhole lens cannot represent
        their errors.

    Raises
    ------
    InputError
        If the lens of a camera folds the image. The message names the camera.
    """
    cameras = {}
    for name, camera in rig.items():
        with camera_name_in_errors(name):
            lens = undistort_lens(camera.intrinsics, alpha=alpha, image_size_px=image_size_px)
        cameras[name] = Camera(lens, camera.pose)
    return with_covariance(cameras, rig)


@contextlib.contextmanager
def camera_name_in_errors(name: str) -> Iterator[None]:
    """Context manager that prefixes the message of an `InputError` with the camera's name."""
    try:
        yield
    except InputError as error:
        raise InputError(f'Camera "{name}": {error}') from error


def with_covariance(cameras: Mapping[str, Camera], rig: Rig) -> Rig:
    """Build the rig of new cameras, with the covariance of `rig` propagated to first order.

    Each new camera has the centre of the camera of `rig` with the same name, and may have another
    rotation and lens. The new rig has no covariance in two cases. First, the covariance of `rig`
    contains lens parameters of a camera that now has another lens. Second, a new optical axis does
    not meet the sheet, so that distance and aim are undefined.
    """
    old_names: list[str] = []
    new_names: list[str] = []
    blocks: list[np.ndarray] = []
    for name, camera in cameras.items():
        camera_parameters = [p for p in rig.parameters if p.rpartition(".")[0] == name]
        poses = [p for p in camera_parameters if p.rpartition(".")[2] in PARAMETER_NAMES]
        has_same_lens = bool(eqx.tree_equal(camera.intrinsics, rig[name].intrinsics))
        if len(poses) < len(camera_parameters) and not has_same_lens:
            return Rig(cameras)
        rotation, old = (np.asarray(each.pose.rotation) for each in (camera, rig[name]))
        if not poses or np.array_equal(rotation, old):
            old_names, new_names = old_names + camera_parameters, new_names + camera_parameters
            blocks.append(np.eye(len(camera_parameters)))
            continue
        names = [f"{name}.{parameter}" for parameter in PARAMETER_NAMES]
        old_names, new_names = old_names + names, new_names + names
        blocks.append(np.asarray(_rotation_jacobian(rig[name].pose.parameters, rotation @ old.T)))
    jacobian = np.asarray(scipy.linalg.block_diag(*blocks))
    if not np.isfinite(jacobian).all():
        return Rig(cameras)
    covariance = jacobian @ rig.covariance_of(old_names) @ jacobian.T
    return Rig(cameras, parameters=new_names, covariance=(covariance + covariance.T) / 2)


@kept_jit
def _rotation_jacobian(
    parameters: Float[ArrayLike, "6"], turn: Float[ArrayLike, "3 3"]
) -> Float[ArrayLike, "6 6"]:
    """Derivative (6, 6) of a rotated camera's pose parameters by those of the original camera.

    Pose parameters are pan, tilt, swing, distance, aim X and aim Y. `parameters` are those of the
    original camera, in rad and mm. `turn` is the rotation in the camera frame, R_new R_old^T. The
    derivative is in degrees and mm.
    """
    unit = jnp.array([jnp.pi / 180] * 3 + [1.0] * 3)

    def of_turned(scaled_parameters: Float[ArrayLike, "6"]) -> Float[ArrayLike, "6"]:
        old = Pose.from_parameters(scaled_parameters * unit)
        new = Pose.from_translation(turn @ old.rotation, turn @ old.translation_mm)
        return new.parameters / unit

    return jax.jacfwd(of_turned)(parameters / unit)
