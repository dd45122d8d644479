"""Mapping of the sheet to the image: homography, plus a cubic for lens distortion.

The cubic is used if there are enough points. The images of circles are ellipses from the
homography.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.tuning.every_group import CalibTuning


class PlaneMapping(NamedTuple):
    """Mapping from points of a plane to image points, px: a homography plus a cubic polynomial.

    Attributes
    ----------
    homography : (3, 3) projective part of the mapping.
    cubic_px : (10, 2) coefficients of the cubic polynomial; zeros if it is not used.
    middle, extent : centre and side of a square in the plane. The arguments of the polynomial are
        (point - middle) / extent.
    """

    homography: Float[np.ndarray, "3 3"]
    cubic_px: Float[np.ndarray, "10 2"]
    middle: Float[np.ndarray, "2"]
    extent: float

    def distortion(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Displacement in the image by the cubic polynomial, px, at points of the plane.

        The polynomial models lens distortion.
        """
        if not self.cubic_px.any():
            return np.zeros_like(points)
        return _cubic_terms((points - self.middle) / self.extent) @ self.cubic_px

    def apply(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Images of points of the plane, px; NaN at or beyond the horizon of the plane."""
        return apply_homography(self.homography, points) + self.distortion(points)

    def log_enlargement(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
        """Logarithm of the local magnification: image area, px^2, per area of the plane, (n,)."""
        depth = points @ self.homography[2, :2] + self.homography[2, 2]
        area = np.abs(np.linalg.det(self.homography) / depth**3)
        return np.log(np.maximum(area, 1e-12))

    def ellipses(
        self, centres: Float[np.ndarray, "n 2"], radius: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
        """Centres, px, and shape matrices, px^2, of the images of circles in the plane."""
        ellipse_centre, shape = images_of_circles(self.homography, centres, radius)
        return ellipse_centre + self.distortion(centres), shape


def fit_plane_mapping(
    points: Float[np.ndarray, "n 2"],
    image_px: Float[np.ndarray, "n 2"],
    radius: Float[np.ndarray, "n"] | None = None,
    *,
    tuning: CalibTuning,
) -> PlaneMapping:
    """Fit the mapping from a plane to an image.

    Parameters
    ----------
    points : (n, 2) points of the plane.
    image_px : (n, 2) images of the points. If `radius` is given, centres of the ellipses that are
        images of circles around the points.
    radius : (n,) radii of these circles in the plane.
    tuning : tuned constants of calibration.
    """
    target = image_px
    homography = fit_homography(points, target)
    if radius is not None:
        ellipse_centre, _ = images_of_circles(homography, points, radius)
        target = image_px - (ellipse_centre - apply_homography(homography, points))
        homography = fit_homography(points, target)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, extent = 0.5 * (low + high), max(float(np.max(high - low)), 1e-9)
    cubic = np.zeros((10, 2))
    if len(points) >= tuning.detection.cubic_points:
        residual = target - apply_homography(homography, points)
        if np.all(np.isfinite(residual)):
            terms = _cubic_terms((points - middle) / extent)
            ridge = tuning.detection.cubic_damping * len(points) * np.eye(10)
            cubic = np.linalg.solve(terms.T @ terms + ridge, terms.T @ residual)
    return PlaneMapping(homography, cubic, middle, extent)


def _cubic_terms(unit: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 10"]:
    """Monomials of x and y up to degree 3."""
    (x, y), one = unit.T, np.ones(len(unit))
    xx, xy, yy = x * x, x * y, y * y
    return np.stack([one, x, y, xx, xy, yy, x * xx, x * xy, x * yy, y * yy], axis=1)


def fit_homography(
    source: Float[np.ndarray, "n 2"], target: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 3"]:
    """Fit a homography by the normalised direct linear transform.

    Parameters
    ----------
    source, target : (n, 2) corresponding points; the homography maps `source` to `target`.

    References
    ----------
    R. Hartley and A. Zisserman, "Multiple View Geometry in Computer Vision", algorithm 4.2.
    """
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
    """Images of points under a homography; NaN at or beyond the horizon of the plane."""
    homogeneous = points @ homography[:, :2].T + homography[:, 2]
    depth = np.where(homogeneous[:, 2] > 1e-9, homogeneous[:, 2], np.nan)
    return homogeneous[:, :2] / depth[:, None]


def images_of_circles(
    homography: Float[np.ndarray, "3 3"],
    centres: Float[np.ndarray, "n 2"],
    radius: Float[np.ndarray, "n"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
    """Centres and shape matrices of the images of circles, from their dual conics.

    The shape matrix of a circle that reaches the horizon is not positive definite.

    Parameters
    ----------
    homography : (3, 3) homography from the plane to the image.
    centres, radius : (n, 2), (n,) circles in the plane.

    Returns
    -------
    (n, 2) centres, and (n, 2, 2) shape matrices S of the ellipses (x - c)^T S^-1 (x - c) = 1.
    """
    homogeneous = np.concatenate([centres, np.ones((len(centres), 1))], axis=1)
    dual = homogeneous[:, :, None] * homogeneous[:, None, :]
    dual = dual - radius[:, None, None] ** 2 * np.diag([1.0, 1.0, 0.0])
    image = homography @ dual @ homography.T
    # Zero if the circle touches the plane through the camera centre: its image is no ellipse.
    scale = np.where(np.abs(image[:, 2:, 2:]) > 1e-12, image[:, 2:, 2:], 1e-12)
    image = image / scale
    centre = image[:, :2, 2]
    return centre, centre[:, :, None] * centre[:, None, :] - image[:, :2, :2]
