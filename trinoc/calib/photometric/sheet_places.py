"""Where the sheet and its edges lie in a picture, and what of it lies under pixels."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.calib.photometric.sheet_point import rays_of_pixels
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens, Pose, project_point
from trinoc.numerics import ArrayLike, inverse_3x3

_CIRCLE_POINTS = 32
_SIDE_POINTS = 16


@jax.jit
def project_to_image(
    pose: Pose, lens: AbstractLens, points_mm: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 2"]:
    """Pixels that image points of the sheet."""
    places = jnp.concatenate([points_mm, jnp.zeros_like(points_mm[:, :1])], axis=1)
    return jax.vmap(project_point, in_axes=(None, None, 0))(pose, lens, places)


def circle_points_mm(
    centres_mm: Float[np.ndarray, "n 2"], radius_mm: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n k 2"]:
    """Points on circles of the sheet."""
    angle = np.arange(_CIRCLE_POINTS) * (2 * np.pi / _CIRCLE_POINTS)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return centres_mm[:, None] + radius_mm[:, None, None] * ring


def line_outlines_mm(pattern: Pattern) -> Float[np.ndarray, "2 k 2"]:
    """Closed outlines of the line along X and of the line along Y."""
    along = np.linspace(-1.0, 1.0, _SIDE_POINTS)
    half = 0.5 * pattern.line_width_mm
    outlines = []
    for axis, reach in enumerate(pattern.line_half_length_mm):
        there = np.stack([reach * along, np.full(_SIDE_POINTS, half)], axis=1)
        outline = np.concatenate([there, -there])
        outlines.append(outline if axis == 0 else outline[:, ::-1])
    return np.stack(outlines)


def sheet_from_camera(pose: Pose) -> Float[ArrayLike, "3 3"]:
    """Homography from directions in the camera to the sheet.

    Its last row is of unit length: a sheet may lie anywhere about the camera.
    """
    inverse = inverse_3x3(pose.cam_from_sheet)
    return inverse / jnp.sqrt(inverse[2] @ inverse[2])


homography_of_pose = jax.jit(sheet_from_camera)


def places_of_pixels(
    column: Shaped[np.ndarray, "n"], row: Shaped[np.ndarray, "n"], pose: Pose, lens: AbstractLens
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Places of a flat sheet under pixels, in mm, and the largest mm per pixel about each."""
    point, (along_u, along_v) = places_and_slopes(column, row, pose, lens)
    squares = (along_u**2).sum(axis=0) + (along_v**2).sum(axis=0)
    area = along_u[0] * along_v[1] - along_u[1] * along_v[0]
    flat = np.sqrt(np.maximum(squares**2 - 4 * area**2, 0.0))
    return point.T, np.sqrt(0.5 * (squares + flat))


def places_and_slopes(
    column: Shaped[np.ndarray, "n"], row: Shaped[np.ndarray, "n"], pose: Pose, lens: AbstractLens
) -> tuple[Float[np.ndarray, "2 n"], tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "2 n"]]]:
    """Places of a flat sheet under pixels, in mm, and their derivatives by u and by v."""
    uv_px = np.stack([column, row], axis=1).astype(np.float64)
    ray = rays_of_pixels(lens, uv_px, with_bend=False)
    direction = np.asarray(ray.direction).T
    matrix = np.asarray(homography_of_pose(pose))
    scale = 1 / (matrix[2] @ direction)
    point = (matrix[:2] @ direction) * scale
    along_u, along_v = (
        (matrix[:2] @ by - point * (matrix[2] @ by)) * scale
        for by in np.moveaxis(np.asarray(ray.by_pixel), 0, -1).swapaxes(0, 1)
    )
    return point, (along_u, along_v)
