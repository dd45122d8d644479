"""Prior of a board's shape, with similar displacements of neighbouring corners.

A plate that warps and a distorted print displace neighbouring corners by nearly the same amount. A
prior of independent displacements is too narrow for such smooth shapes: it reduces them by
1/sqrt(corners), and the sigmas of principal points become several times too small. This prior is a
sum of independent parts with one variance each:

    covariance of the shape = sum over parts of variance * modes modes^T,

where the modes of a part are polynomials over the board, or single corners.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import first_point_indices, list_boards
from trinoc.calib.tuning.every_group import TUNING, CalibTuning

# numerical: polynomials with a smaller relative norm are dependent on the corners of a small board.
_DEPENDENT = 1e-6
# numerical: the smallest standard deviation of a part, mm.
_SMALLEST_MM = 1e-4
# numerical: degrees of the smooth displacements across the plane, of second order and above (lower
# ones move or tilt the board), and within the plane (first order: see `shear`).
_HEIGHT_DEGREE, _PLANE_DEGREE = 4, 3


class ShapePart(NamedTuple):
    """One part of the prior of a board's shape: displacements that share one variance.

    Attributes
    ----------
    name : name of the part.
    modes : (3n, w) displacements X, Y, Z of n corners, mm, for a unit amplitude of each of w modes.
    is_estimated : whether the variance of the amplitudes is estimated from the images; if not, it
        is fixed.
    """

    name: str
    modes: Float[np.ndarray, "_ w"]
    is_estimated: bool


class ShapePrior(NamedTuple):
    """Gaussian prior of the displacements of all corners of a board: a sum of independent parts.

    Attributes
    ----------
    parts : parts of the prior.
    variance : (k,) variance of the mode amplitudes of each of k parts.
    """

    parts: tuple[ShapePart, ...]
    variance: Float[np.ndarray, "k"]

    @property
    def covariance_mm2(self) -> Float[np.ndarray, "m m"]:
        """Prior covariance of the X, Y and Z displacements of all corners, mm^2."""
        modes = np.hstack([part.modes for part in self.parts])
        spread = np.repeat(self.variance, [part.modes.shape[1] for part in self.parts])
        return (modes * spread) @ modes.T

    @property
    def information(self) -> Float[np.ndarray, "m m"]:
        """Inverse of `covariance_mm2`, 1/mm^2."""
        inverse = np.linalg.inv(self.covariance_mm2)
        return 0.5 * (inverse + inverse.T)

    def update(
        self, shape_mm: Float[np.ndarray, "n 3"], covariance_mm2: Float[np.ndarray, "m m"]
    ) -> "ShapePrior":
        """Prior with variances from one step of expectation maximisation.

        shape_mm : (n, 3) posterior mean of the displacements under the present prior.
        covariance_mm2 : (3n, 3n) their posterior covariance.

        References
        ----------
        Dempster, Laird and Rubin, "Maximum likelihood from incomplete data via the EM algorithm"
        (1977), for components of variance.
        """
        information = self.information
        by_mean = information @ shape_mm.ravel()
        by_covariance = information @ covariance_mm2 @ information
        variance = self.variance.copy()
        for k, part in enumerate(self.parts):
            if not part.is_estimated:
                continue
            count, modes = part.modes.shape[1], part.modes
            squares = np.sum((modes.T @ by_mean) ** 2)
            squares += np.sum(modes * ((by_covariance - information) @ modes))
            variance[k] += variance[k] ** 2 * squares / count
        return self._replace(variance=np.maximum(variance, _SMALLEST_MM**2))

    def count_determined(self, covariance_mm2: Float[np.ndarray, "m m"]) -> float:
        """Effective number of displacement coordinates that the images determine.

        covariance_mm2 : (3n, 3n) posterior covariance of the displacements.
        """
        return float(len(covariance_mm2) - np.sum(self.information * covariance_mm2))


def shape_prior(
    target: AbstractTarget, spread_mm: float, tuning: CalibTuning = TUNING
) -> ShapePrior:
    """Initial prior of the corner displacements of a board, or of a set of boards.

    spread_mm : initial standard deviation of the estimated parts: single corners and smooth modes.
    """
    flatness, shear = tuning.uncertainty.flatness_mm, tuning.problem.shear
    boards = [
        _smooth_parts(np.asarray(board.centres_mm)[:, :2], int(first), len(target))
        for first, board in zip(first_point_indices(target), list_boards(target), strict=True)
    ]
    parts, variance = [], []
    for name, sigma, is_estimated in (
        ("shear", shear, False),
        ("twist", flatness, False),
        ("height", spread_mm, True),
        ("plane", spread_mm, True),
    ):
        modes = np.hstack([board[name] for board in boards])
        if modes.shape[1]:
            parts.append(ShapePart(name, modes, is_estimated))
            variance.append(sigma**2)
    identity = np.eye(3 * len(target))
    is_height = np.arange(3 * len(target)) % 3 == 2
    for name, columns in (("corner plane", ~is_height), ("corner height", is_height)):
        parts.append(ShapePart(name, identity[:, columns], True))
        variance.append(spread_mm**2)
    return ShapePrior(tuple(parts), np.array(variance))


def _smooth_parts(
    xy_mm: Float[np.ndarray, "n 2"], first: int, total: int
) -> dict[str, Float[np.ndarray, "_ _w"]]:
    """Modes of smooth displacements of one board, (3 total, w), by the name of the prior's part.

    "height" (perpendicular to the board) and "plane" (within it) are orthogonal polynomials of the
    position, with a root mean square of 1 mm over the n corners. "twist" is the saddle x y, with a
    height of 1 mm at the corners of the board's outline. "shear" is a shear of 1 within the plane.

    xy_mm : positions of the board's n corners.
    first : index of its first corner among the corners of all boards.
    total : number of corners of all boards.
    """
    count = len(xy_mm)
    middle = 0.5 * (xy_mm.max(axis=0) + xy_mm.min(axis=0))
    u, v = ((xy_mm - middle) / np.maximum(np.ptp(xy_mm, axis=0) / 2, 1e-9)).T

    def powers(degree: int) -> Float[np.ndarray, "n _"]:
        return np.stack([u**k * v ** (d - k) for d in range(degree + 1) for k in range(d + 1)], 1)

    def embed(displacement_mm: Float[np.ndarray, "n 3 w"]) -> Float[np.ndarray, "_ w"]:
        all_displacements = np.zeros((total, 3, displacement_mm.shape[-1]))
        all_displacements[first : first + count] = displacement_mm
        return all_displacements.reshape(3 * total, -1)

    height, plane = powers(_HEIGHT_DEGREE), powers(_PLANE_DEGREE)
    # Constant and slopes tilt the board; the squares along its sides are the sheet's own warps.
    fixed_columns = np.concatenate([height[:, :3], (u * u)[:, None], (v * v)[:, None]], axis=1)
    twist = np.zeros((count, 3, 1))
    twist[:, 2, 0] = u * v
    height_modes = _orthogonal(
        np.concatenate([fixed_columns, twist[:, 2], height[:, 6:]], axis=1), 6
    )
    heights = np.zeros((count, 3, height_modes.shape[1]))
    heights[:, 2] = height_modes
    plane_modes = _orthogonal(plane, 3)
    planes = np.zeros((count, 3, 2 * plane_modes.shape[1]))
    planes[:, 0, : plane_modes.shape[1]] = planes[:, 1, plane_modes.shape[1] :] = plane_modes
    shear = np.zeros((count, 3, 1))
    shear[:, :2, 0] = 0.5 * (xy_mm - middle)[:, ::-1]
    return {
        "shear": embed(shear),
        "twist": embed(twist),
        "height": embed(heights),
        "plane": embed(planes),
    }


def _orthogonal(columns: Float[np.ndarray, "n k"], skipped: int) -> Float[np.ndarray, "n _w"]:
    """Orthogonalise columns, scale them to a root mean square of 1, and drop the first `skipped`.

    Columns that depend linearly on earlier ones are dropped, too.
    """
    basis, triangle = np.linalg.qr(columns)
    size = np.abs(np.diag(triangle))
    independent = size > _DEPENDENT * size.max()
    independent[:skipped] = False
    return basis[:, independent] * np.sqrt(len(columns))
