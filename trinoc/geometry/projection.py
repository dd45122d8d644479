"""The projection of all fits and tools: from a point of the world to a pixel."""

from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.numerics import ArrayLike, NumpyOrTraced, in_bucket


def project_point(
    pose: Pose, lens: AbstractLens, point_world_mm: Float[ArrayLike, "3"]
) -> Float[ArrayLike, "2"]:
    """The pixel that images a point through a lens; for use under `jit`, `grad` and `vmap`.

    Meaningless for a point that the lens cannot see, such as one behind a pinhole camera.
    """
    return lens.project_ray(pose.transform(point_world_mm))


def project_by_matrix(
    matrix_px: Float[ArrayLike, "3 4"], points_world_mm: Float[ArrayLike, "*n 3"]
) -> Float[NumpyOrTraced, "*n 2"]:
    """Undistorted pixels of points by a projection matrix; in NumPy where both are NumPy.

    Source: Hartley and Zisserman, section 6.1.
    """
    image: Any = points_world_mm @ matrix_px[:, :3].T + matrix_px[:, 3]
    return image[..., :2] / image[..., 2:]


def project_points(
    pose: Pose, lens: AbstractLens, points_world_mm: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 2"]:
    """`project_point` of any number of points, which few programs serve."""
    return in_bucket(partial(_project_points, pose, lens), points_world_mm)


def unproject_pixels(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Unit rays, in the camera frame, of any number of pixels, which few programs serve."""
    return in_bucket(partial(_unproject_pixels, lens), uv_px)


@jax.jit
def _project_points(
    pose: Pose, lens: AbstractLens, points_world_mm: Float[ArrayLike, "n 3"]
) -> Float[ArrayLike, "n 2"]:
    return jax.vmap(partial(project_point, pose, lens))(points_world_mm)


@jax.jit
def _unproject_pixels(
    lens: AbstractLens, uv_px: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 3"]:
    return jax.vmap(lens.unproject)(uv_px)
