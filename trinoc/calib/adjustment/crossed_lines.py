"""A first camera from the images of the crossed lines.

With a known focal length each line's image is a plane through the camera's centre. The two
planes meet in the ray to the crossing. The axes X and Y lie in one plane each and are
perpendicular, which leaves one angle free: how far the line along X runs into the depth of
the picture. The circles choose that angle, and the distance follows linearly.
"""

import numpy as np
from jaxtyping import Float

# Steps of 7.5 degrees: the parabola through the best three is then good to a degree or two.
_ANGLES_RAD = np.arange(48) * (2 * np.pi / 48)


def pose_of_crossed_lines(
    planes: Float[np.ndarray, "2 3"],
    slopes: Float[np.ndarray, "m 2"],
    place_mm: Float[np.ndarray, "m 2"],
) -> Float[np.ndarray, "3 4"] | None:
    """The pose of the crossed lines whose circles lie nearest to the observed ones.

    planes : normals, in the camera's frame, of the planes of the lines along X and along Y.
    slopes : x/z and y/z of the ray to each circle. place_mm : the circles' centres.

    None where a line was not seen, or no such pose has the circles in front.
    """
    if not np.isfinite(planes).all():
        return None
    normal_x, normal_y = _unit(planes)
    ray = _unit(np.cross(normal_x, normal_y))
    ray = ray * np.sign(ray[2])
    misfits = [_distance_and_misfit(normal_x, normal_y, ray, slopes, place_mm, angle)[1]
               for angle in _ANGLES_RAD]  # fmt: skip
    best = int(np.argmin(misfits))
    if not np.isfinite(misfits[best]):
        return None
    before, at, after = (misfits[(best + step) % len(_ANGLES_RAD)] for step in (-1, 0, 1))
    bend = before - 2 * at + after
    shift = (before - after) / (2 * bend) if np.isfinite(bend) and bend > 0 else 0.0
    angle = _ANGLES_RAD[best] + shift * _ANGLES_RAD[1]
    distance_mm, _ = _distance_and_misfit(normal_x, normal_y, ray, slopes, place_mm, angle)
    return np.column_stack([_rotation(normal_x, normal_y, ray, angle), distance_mm * ray])


def _rotation(
    normal_x: Float[np.ndarray, "3"],
    normal_y: Float[np.ndarray, "3"],
    ray: Float[np.ndarray, "3"],
    angle_rad: float,
) -> Float[np.ndarray, "3 3"]:
    """Axes of the sheet in the camera's frame, X turned so far out of the ray to the crossing."""
    axis_x = np.cos(angle_rad) * ray + np.sin(angle_rad) * np.cross(normal_x, ray)
    axis_y = _unit(np.cross(normal_y, axis_x))
    # The camera sees the sheet from above: Z points against the ray to the crossing.
    axis_y = -np.sign(np.cross(axis_x, axis_y) @ ray) * axis_y
    return np.stack([axis_x, axis_y, np.cross(axis_x, axis_y)], axis=1)


def _distance_and_misfit(
    normal_x: Float[np.ndarray, "3"],
    normal_y: Float[np.ndarray, "3"],
    ray: Float[np.ndarray, "3"],
    slopes: Float[np.ndarray, "m 2"],
    place_mm: Float[np.ndarray, "m 2"],
    angle_rad: float,
) -> tuple[float, float]:
    """The distance that fits best in the plane of the picture, and the sum of squares it leaves;
    infinite where a circle lies behind."""
    offset = place_mm @ _rotation(normal_x, normal_y, ray, angle_rad)[:, :2].T
    slope = ray[:2] - slopes * ray[2]
    target = slopes * offset[:, 2:] - offset[:, :2]
    distance_mm = float(np.sum(slope * target) / np.sum(slope * slope))
    points = offset + distance_mm * ray
    if not (distance_mm > 0 and (points[:, 2] > 0).all()):
        return distance_mm, np.inf
    return distance_mm, float(np.sum((points[:, :2] / points[:, 2:] - slopes) ** 2))


def _unit(vector: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
