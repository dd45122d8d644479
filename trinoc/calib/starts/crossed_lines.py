"""Initial pose of a camera from the images of the two crossed lines."""

import numpy as np
from jaxtyping import Float

from trinoc.geometry.pose import Pose

# numerical: steps of 7.5 degrees; the parabola through the best three is accurate to one or two
# degrees.
_ANGLES_RAD = np.arange(48) * (2 * np.pi / 48)


def pose_of_crossed_lines(
    planes: Float[np.ndarray, "2 3"],
    slopes: Float[np.ndarray, "m 2"],
    circle_mm: Float[np.ndarray, "m 2"],
) -> Pose | None:
    """Pose of a camera from the images of the two crossed lines and the circles of the sheet.

    The lines determine the pose up to one angle and the distance, which are fitted to the circles.

    Parameters
    ----------
    planes : (2, 3) normals, in the frame of the camera, of the planes through the camera's centre
        and the lines along X and Y.
    slopes : (m, 2) x/z and y/z of the ray to each circle.
    circle_mm : (m, 2) circle centres on the sheet.

    Returns
    -------
    The pose. None if a line was not detected, or if no pose has all circles in front of the camera.
    """
    if not np.isfinite(planes).all():
        return None
    normal_x, normal_y = _unit(planes)
    ray = _unit(np.cross(normal_x, normal_y))
    ray = ray * np.sign(ray[2])

    def view_circle(
        angles_rad: Float[np.ndarray, "a"],
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        axes = _axes(normal_x, normal_y, ray, angles_rad)
        return axes, *_distance_and_misfit(axes, ray, slopes, circle_mm)

    _, _, misfit = view_circle(_ANGLES_RAD)
    best = int(np.argmin(misfit))
    if not np.isfinite(misfit[best]):
        return None
    previous, central, next_misfit = misfit[(best + np.array([-1, 0, 1])) % len(_ANGLES_RAD)]
    curvature = previous - 2 * central + next_misfit
    shift = (
        (previous - next_misfit) / (2 * curvature)
        if np.isfinite(curvature) and curvature > 0
        else 0.0
    )
    (axes,), (distance_mm,), _ = view_circle(_ANGLES_RAD[best : best + 1] + shift * _ANGLES_RAD[1])
    return Pose(np.column_stack([axes, distance_mm * ray]))


def _axes(
    normal_x: Float[np.ndarray, "3"],
    normal_y: Float[np.ndarray, "3"],
    ray: Float[np.ndarray, "3"],
    angles_rad: Float[np.ndarray, "a"],
) -> Float[np.ndarray, "a 3 3"]:
    """Rotations from the sheet to the camera that agree with the images of both lines, (a, 3, 3).

    normal_x, normal_y : normals of the planes through the camera's centre and each line.
    ray : unit vector to the crossing of the lines.
    angles_rad : angles between the X axis of the sheet and `ray`.
    """
    across = np.cross(normal_x, ray)
    axis_x = np.cos(angles_rad)[:, None] * ray + np.sin(angles_rad)[:, None] * across
    axis_y = _unit(np.cross(normal_y, axis_x))
    # The camera sees the sheet from above: Z points against the ray to the crossing.
    axis_y *= -np.sign(np.cross(axis_x, axis_y) @ ray)[:, None]
    return np.stack([axis_x, axis_y, np.cross(axis_x, axis_y)], axis=2)


def _distance_and_misfit(
    axes: Float[np.ndarray, "a 3 3"],
    ray: Float[np.ndarray, "3"],
    slopes: Float[np.ndarray, "m 2"],
    circle_mm: Float[np.ndarray, "m 2"],
) -> tuple[Float[np.ndarray, "a"], Float[np.ndarray, "a"]]:
    """For each rotation, least-squares distance of the sheet from its circles, and the squared
    residuals.

    Parameters
    ----------
    axes : (a, 3, 3) possible rotations from the sheet to the camera.
    ray : unit vector from the camera to the crossing of the lines.
    slopes : (m, 2) x/z and y/z of the ray to each circle.
    circle_mm : (m, 2) circle centres on the sheet.

    Returns
    -------
    Distance of the crossing along `ray`, mm, (a,), and sum of the squared residuals of `slopes`,
    (a,). The sum is infinite if a circle would lie behind the camera.
    """
    offset = circle_mm @ np.swapaxes(axes[:, :, :2], 1, 2)
    slope = ray[:2] - slopes * ray[2]
    target = slopes * offset[..., 2:] - offset[..., :2]
    distance_mm = np.sum(slope * target, axis=(1, 2)) / np.sum(slope * slope)
    points = offset + distance_mm[:, None, None] * ray
    in_front = (distance_mm > 0) & (points[..., 2] > 0).all(axis=1)
    depth = np.where(points[..., 2:] > 0, points[..., 2:], 1.0)
    misfit = np.sum((points[..., :2] / depth - slopes) ** 2, axis=(1, 2))
    return distance_mm, np.where(in_front, misfit, np.inf)


def _unit(vector: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
