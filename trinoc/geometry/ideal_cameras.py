"""Cameras without distortion in the place of real ones: their lenses, and what is known of them."""

import contextlib
from collections.abc import Iterator, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

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
    """A lens without distortion, whose pixels have the shape of those of another.

    alpha : 0 keeps the largest part of the field in which all pixels are valid; 1 keeps all of it,
        up to WIDEST_DEG from the axis; between, a part between.
    image_size_px : (width, height) of its pictures, by default those of `lens`.

    An ideal lens stays as it is, unless its pictures change. Raises InputError for a distortion
    that folds the picture.
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
            "No part of the picture can be shown without distortion: check the coefficients."
        )
    return ideal_lens(shape, windows.scale_px, windows.origins_px[0], size_px)


def expect_alpha(alpha: float) -> None:
    """Raise InputError for a share of the field that is none."""
    if not 0 <= real_number(alpha, "alpha") <= 1:
        raise InputError(
            f"alpha is {alpha:g}: give 0 for valid pixels alone, 1 for the whole field, or a "
            "number between."
        )


def ideal_lens(
    shape: Float[np.ndarray, "2 2"],
    scale_px: float,
    origin_px: Float[np.ndarray, "2"],
    size_px: tuple[int, int],
) -> Intrinsics:
    """A lens of K = scale [shape | 0] with its principal point, whose shape has a 1 first."""
    matrix = np.eye(3)
    matrix[:2] = np.column_stack([scale_px * shape, origin_px])
    return Intrinsics.from_matrix(matrix, size_px)


@in_float64
def undistort_rig(
    rig: Rig, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> Rig:
    """The cameras with lenses of `undistort_lens`, which look as they did.

    The covariance is that of the rig, or none where it holds lenses that change. Raises InputError.
    """
    cameras = {}
    for name, camera in rig.items():
        with say_which_camera(name):
            lens = undistort_lens(camera.intrinsics, alpha=alpha, image_size_px=image_size_px)
        cameras[name] = Camera(lens, camera.pose)
    return with_covariance(cameras, rig)


@contextlib.contextmanager
def say_which_camera(name: str) -> Iterator[None]:
    """An InputError of the block says of which camera it is."""
    try:
        yield
    except InputError as error:
        raise InputError(f'Camera "{name}": {error}') from error


def with_covariance(cameras: Mapping[str, Camera], rig: Rig) -> Rig:
    """A rig of ideal cameras, with the covariance of the rig they are made from, to first order.

    Without one where that has errors of lenses that are not kept, which bend the rays of a picture
    as no ideal camera does, and where a turned axis does not meet the sheet, which leaves no
    distance and aim.
    """
    before: list[str] = []
    after: list[str] = []
    blocks: list[np.ndarray] = []
    for name, camera in cameras.items():
        known = [p for p in rig.parameters if p.rpartition(".")[0] == name]
        poses = [p for p in known if p.rpartition(".")[2] in PARAMETER_NAMES]
        is_kept = bool(eqx.tree_equal(camera.intrinsics, rig[name].intrinsics))
        if len(poses) < len(known) and not is_kept:
            return Rig(cameras)
        rotation, old = (np.asarray(each.pose.rotation) for each in (camera, rig[name]))
        if not poses or np.array_equal(rotation, old):
            before, after = before + known, after + known
            blocks.append(np.eye(len(known)))
            continue
        names = [f"{name}.{own}" for own in PARAMETER_NAMES]
        before, after = before + names, after + names
        blocks.append(np.asarray(_change_of_turned(rig[name].pose.parameters, rotation @ old.T)))
    jacobian = np.asarray(block_diag(*blocks))
    if not np.isfinite(jacobian).all():
        return Rig(cameras)
    covariance = jacobian @ rig.covariance_of(before) @ jacobian.T
    return Rig(cameras, parameters=after, covariance=(covariance + covariance.T) / 2)


@kept_jit
def _change_of_turned(
    parameters: Float[ArrayLike, "6"], turn: Float[ArrayLike, "3 3"]
) -> Float[ArrayLike, "6 6"]:
    """Derivative of pan, tilt, swing, distance and aim of a turned camera by those before, in
    degrees and mm; `parameters` are in rad."""
    unit = jnp.array([jnp.pi / 180] * 3 + [1.0] * 3)

    def of_turned(given: Float[ArrayLike, "6"]) -> Float[ArrayLike, "6"]:
        old = Pose.from_parameters(given * unit)
        new = Pose.from_translation(turn @ old.rotation, turn @ old.translation_mm)
        return new.parameters / unit

    return jax.jacfwd(of_turned)(parameters / unit)
