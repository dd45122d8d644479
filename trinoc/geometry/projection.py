"""The projection of all fits and tools: from a point of the world to a pixel."""

from typing import Any

from jaxtyping import Float

from trinoc.geometry.lenses import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.numerics import ArrayLike, NumpyOrTraced


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
