"""What the cameras' errors do to what people use a rig for: epipolar lines and points."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry import (
    AFFINE_PARAMETERS,
    PARAMETER_NAMES,
    Camera,
    Pose,
    Rig,
    epipolar_distance_px,
    fundamental_matrix,
    project_by_matrix,
    sheet_from_pixel,
    triangulate_point,
)
from trinoc.numerics import ArrayLike, in_float64

# Places across the picture, along each side.
_PLACES = 5
# Of one camera: its pose, then its lens without distortion.
_NAMES = PARAMETER_NAMES + AFFINE_PARAMETERS
_TO_RADIANS = np.array([*np.full(3, np.pi / 180), *np.ones(len(_NAMES) - 3)])


class EpipolarSigma(NamedTuple):
    """Standard deviation of the distance of a true match from its epipolar line.

    Fields
    ------
    uv_px : (n, 2) places in the first picture.
    sigma_px : (n,) in the second, for the point of the sheet's plane seen there.
    """

    uv_px: Float[np.ndarray, "n 2"]
    sigma_px: Float[np.ndarray, "n"]


@in_float64
def epipolar_sigma(rig: Rig, first: str, second: str) -> EpipolarSigma:
    """How well the rig knows its epipolar lines, over the field of the first picture.

    Where the rig's covariance holds focal lengths and principal points, their errors are in, with
    those of the pose that go with them. Undistorted pixels. Raises InputError for a rig without a
    covariance.
    """
    covariance, values = _known(rig, (first, second))
    width, height = rig[first].image_size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, _PLACES), np.linspace(0, height - 1, _PLACES))
    places = np.stack([u.ravel(), v.ravel()], axis=1)
    matrices = np.stack([np.asarray(rig[name].intrinsics.matrix) for name in (first, second)])
    ideal = _without_distortion(rig[first])
    jacobian = np.asarray(_distances_by_change(values, matrices, ideal, places))
    return EpipolarSigma(places, _sigmas(jacobian.reshape(len(places), -1), covariance))


@jax.jit
def _distances_by_change(
    values: Float[ArrayLike, "2 p"],
    matrices: Float[ArrayLike, "2 3 3"],
    first: Camera,
    places: Float[ArrayLike, "n 2"],
) -> Float[ArrayLike, "n 2 p"]:
    """Derivatives of the distances from the epipolar lines by the parameters of both cameras."""
    points = jax.vmap(sheet_from_pixel, (None, 0))(first, places)
    there = _projections(values, matrices)

    def distances(change: Float[ArrayLike, "2 p"]) -> Float[ArrayLike, "n"]:
        moved = _projections(values + change, matrices)
        fundamental = fundamental_matrix(moved[1], moved[0])

        def distance(uv: Float[ArrayLike, "2"], point: Float[ArrayLike, "2"]) -> ArrayLike:
            image = project_by_matrix(there[1], jnp.append(point, 0.0))
            return epipolar_distance_px(fundamental, image, uv)

        return jax.vmap(distance)(places, points)

    return jax.jacfwd(distances)(jnp.zeros_like(values))


@in_float64
def point_covariance(rig: Rig, point_mm: Float[ArrayLike, "3"]) -> np.ndarray:
    """(3, 3) covariance, mm^2, of a point triangulated by all cameras from exact images.

    The errors of the lenses are in, as in `epipolar_sigma`; that of the images comes on top. Raises
    InputError for a rig without a covariance.
    """
    covariance, values = _known(rig, rig.names)
    matrices = np.stack([np.asarray(camera.intrinsics.matrix) for _, camera in rig.items()])
    jacobian = np.asarray(_place_by_change(values, matrices, np.asarray(point_mm, float)))
    jacobian = jacobian.reshape(3, -1)
    return jacobian @ covariance @ jacobian.T


@jax.jit
def _place_by_change(
    values: Float[ArrayLike, "v p"],
    matrices: Float[ArrayLike, "v 3 3"],
    point_mm: Float[ArrayLike, "3"],
) -> Float[ArrayLike, "3 v p"]:
    """Derivatives of the place triangulated from exact images by the cameras' parameters."""
    seen = project_by_matrix(_projections(values, matrices), point_mm[None, None])[:, 0]
    weight = jnp.ones(len(values))

    def place(change: Float[ArrayLike, "v p"]) -> Float[ArrayLike, "3"]:
        return triangulate_point(_projections(values + change, matrices), seen, weight)

    return jax.jacfwd(place)(jnp.zeros_like(values))


def _known(
    rig: Rig, names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "v p"]]:
    """Covariance, in rad, mm and px, and values of pose and lens; absent ones are exact."""
    if not rig.parameters:
        raise InputError("This rig holds no covariance: calibrate it, or load one that does.")
    keys = [f"{name}.{parameter}" for name in names for parameter in _NAMES]
    rows = [rig.parameters.index(key) if key in rig.parameters else -1 for key in keys]
    given = np.array(rows) >= 0
    full = np.zeros((len(keys), len(keys)))
    chosen = np.asarray(rig.covariance)[np.ix_(rows, rows)]
    full[np.ix_(given, given)] = chosen[np.ix_(given, given)]
    scale = np.tile(_TO_RADIANS, len(names))
    values = [_parameters(rig[name]) for name in names]
    return full * np.outer(scale, scale), np.stack(values)


def _parameters(camera: Camera) -> Float[np.ndarray, "p"]:
    lens = camera.intrinsics
    return np.concatenate([camera.pose.parameters, lens.focal_length_px, lens.principal_point_px])


def _without_distortion(camera: Camera) -> Camera:
    lens = camera.intrinsics
    return Camera(type(lens).from_matrix(lens.matrix, lens.image_size_px), camera.pose)


def _projections(
    values: Float[ArrayLike, "v p"], matrices: Float[ArrayLike, "v 3 3"]
) -> Float[ArrayLike, "v 3 4"]:
    """Of cameras with these poses, focal lengths and principal points; `matrices` hold the skew."""

    def projection(vector: Float[ArrayLike, "p"], matrix: Float[ArrayLike, "3 3"]) -> ArrayLike:
        pose, (fu, fv, cu, cv) = vector[: len(PARAMETER_NAMES)], vector[len(PARAMETER_NAMES) :]
        affine = jnp.asarray(matrix).at[(0, 1, 0, 1), (0, 1, 2, 2)].set(jnp.stack([fu, fv, cu, cv]))
        return affine @ Pose.from_parameters(pose).cam_from_world

    return jax.vmap(projection)(values, matrices)


def _sigmas(
    jacobian: Float[np.ndarray, "n p"], covariance: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, "n"]:
    return np.sqrt(np.einsum("np,pq,nq->n", jacobian, covariance, jacobian))
