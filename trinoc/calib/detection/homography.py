"""Plane to plane: the homography through point pairs, and what it does to small circles."""

import numpy as np
from jaxtyping import Float


def fit_homography(
    source: Float[np.ndarray, "n 2"], target: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 3"]:
    """Direct linear transform, both sides normalised (Hartley and Zisserman, algorithm 4.2)."""
    to_unit_source, unit_source = _normalise(source)
    to_unit_target, unit_target = _normalise(target)
    count = len(source)
    rows = np.zeros((2 * count, 9))
    rows[:count, :2] = rows[count:, 3:5] = unit_source
    rows[:count, 2] = rows[count:, 5] = 1.0
    value = unit_target.T.reshape(-1, 1)
    rows[:count, 6:8] = rows[count:, 6:8] = unit_source
    rows[:, 6:8] *= -value
    rows[:, 8:] = -value
    _, vectors = np.linalg.eigh(rows.T @ rows)
    unit = vectors[:, 0].reshape(3, 3)
    homography = np.linalg.solve(to_unit_target, unit @ to_unit_source)
    scale = homography[2, 2] if abs(homography[2, 2]) > 1e-12 else 1e-12
    return homography / scale


def _normalise(
    points: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "n 2"]]:
    mean = np.add.reduce(points) / len(points)
    relative = points - mean
    spread = max(float(np.sqrt(np.vdot(relative, relative) / relative.size)), 1e-9)
    to_unit = np.diag([1.0 / spread, 1.0 / spread, 1.0])
    to_unit[:2, 2] = -mean / spread
    return to_unit, relative / spread


def apply_homography(
    homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Images of points; NaN for those at or beyond the plane's horizon."""
    homogeneous = points @ homography[:, :2].T + homography[:, 2]
    depth = np.where(homogeneous[:, 2] > 1e-9, homogeneous[:, 2], np.nan)
    return homogeneous[:, :2] / depth[:, None]


def jacobian_of_homography(
    homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2 2"]:
    """Derivative of the image with respect to the point, columns by source axis."""
    homogeneous = points @ homography[:, :2].T + homography[:, 2]
    image = homogeneous[:, :2] / homogeneous[:, 2:]
    numerator = homography[None, :2, :2] - image[:, :, None] * homography[None, 2:, :2]
    return numerator / homogeneous[:, 2, None, None]


def images_of_circles(
    homography: Float[np.ndarray, "3 3"],
    centres: Float[np.ndarray, "n 2"],
    radius: Float[np.ndarray, "n"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
    """Centre and shape S of the ellipses that circles become (from their dual conics).

    A circle that reaches the horizon has a shape that is not positive definite.
    """
    homogeneous = np.concatenate([centres, np.ones((len(centres), 1))], axis=1)
    dual = homogeneous[:, :, None] * homogeneous[:, None, :]
    dual = dual - radius[:, None, None] ** 2 * np.diag([1.0, 1.0, 0.0])
    image = homography @ dual @ homography.T
    # Zero where the circle touches the camera's own plane; such circles are no ellipses.
    scale = np.where(np.abs(image[:, 2:, 2:]) > 1e-12, image[:, 2:, 2:], 1e-12)
    image = image / scale
    centre = image[:, :2, 2]
    return centre, centre[:, :, None] * centre[:, None, :] - image[:, :2, :2]
