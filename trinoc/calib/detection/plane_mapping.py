"""A plane seen through a lens: a homography, and a smooth bend once points allow it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.homography import (
    apply_homography,
    fit_homography,
    images_of_circles,
    jacobian_of_homography,
)

_BEND_POINTS = 16
# Ridge that keeps the bend from following noise, relative to the number of points.
_BEND_DAMPING = 1e-3


class PlaneMapping(NamedTuple):
    """Map of the plane to the picture.

    homography : (3, 3).
    bend_px : (10, 2) coefficients of a cubic added to it; zeros without.
    middle, extent : the cubic's unit square.
    """

    homography: Float[np.ndarray, "3 3"]
    bend_px: Float[np.ndarray, "10 2"]
    middle: Float[np.ndarray, "2"]
    extent: float

    def bend(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """What the lens adds to the homography, in pixels."""
        if not self.bend_px.any():
            return np.zeros_like(points)
        return _cubic_terms((points - self.middle) / self.extent) @ self.bend_px

    def apply(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Pictures of points; NaN beyond the horizon."""
        return apply_homography(self.homography, points) + self.bend(points)

    def log_enlargement(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
        """Log of the area in pixels of a unit area of the plane."""
        jacobian = jacobian_of_homography(self.homography, points)
        return np.log(np.maximum(np.abs(np.linalg.det(jacobian)), 1e-12))

    def ellipses(
        self, centres: Float[np.ndarray, "n 2"], radius: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
        """Centres and shapes of the pictures of circles."""
        ellipse_centre, shape = images_of_circles(self.homography, centres, radius)
        return ellipse_centre + self.bend(centres), shape


def fit_plane_mapping(
    points: Float[np.ndarray, "n 2"],
    places_px: Float[np.ndarray, "n 2"],
    radius: Float[np.ndarray, "n"] | None = None,
) -> PlaneMapping:
    """The warp through point pairs.

    radius : of the circles whose ellipse centres `places_px` are; without it the places are
        taken as pictures of the points.
    """
    target = places_px
    homography = fit_homography(points, target)
    if radius is not None:
        ellipse_centre, _ = images_of_circles(homography, points, radius)
        target = places_px - (ellipse_centre - apply_homography(homography, points))
        homography = fit_homography(points, target)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, extent = 0.5 * (low + high), max(float(np.max(high - low)), 1e-9)
    bend = np.zeros((10, 2))
    if len(points) >= _BEND_POINTS:
        residual = target - apply_homography(homography, points)
        if np.all(np.isfinite(residual)):
            terms = _cubic_terms((points - middle) / extent)
            damped = terms.T @ terms + _BEND_DAMPING * len(points) * np.eye(10)
            bend = np.linalg.solve(damped, terms.T @ residual)
    return PlaneMapping(homography, bend, middle, extent)


def _cubic_terms(unit: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 10"]:
    terms = np.empty((len(unit), 10))
    terms[:, 0] = 1.0
    terms[:, 1:3] = unit
    terms[:, 3:5] = unit[:, :1] * unit
    terms[:, 5] = unit[:, 1] ** 2
    terms[:, 6:9] = unit[:, :1] * terms[:, 3:6]
    terms[:, 9] = unit[:, 1] * terms[:, 5]
    return terms
