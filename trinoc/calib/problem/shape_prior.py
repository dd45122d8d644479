"""Prior of a board's shape: displacements of neighbouring corners are alike.

A plate that warps and a print that is distorted displace neighbouring corners by nearly the same
amount. A prior of independent displacements allows such smooth shapes too little: it holds them to
1/sqrt(corners) of the displacements it was estimated from, and principal points are then reported
several times too exact. The prior here is a sum of independent parts, each with one variance:

    covariance of the shape = sum over parts of variance * modes modes^T,

where the modes of a part are polynomials over the board, or single corners.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import first_point_indices, list_boards
from trinoc.calib.tuning.every_group import TUNING, CalibTuning

# numerical: polynomials that the corners of a small board do not tell apart have less of the norm.
_DEPENDENT = 1e-6
# numerical: the smallest standard deviation of a part, mm.
_SMALLEST_MM = 1e-4
# numerical: degrees of the smooth displacements across the plane, of second order and above (lower
# ones move or tilt the board), and within the plane (first order: see `shear`).
_HEIGHT_DEGREE, _PLANE_DEGREE = 4, 3


class ShapePart(NamedTuple):
    """One part of the prior.

    Fields
    ------
    name : what it is.
    modes : (3n, w) X, Y and Z in mm of each of n corners, for each of w amplitudes of one variance.
    is_estimated : whether the variance is estimated from the images, or fixed.
    """

    name: str
    modes: Float[np.ndarray, "_ w"]
    is_estimated: bool


class ShapePrior(NamedTuple):
    """The parts and the variances of their amplitudes.

    Fields
    ------
    parts : of the prior.
    variance : (k,) of the amplitudes of each part.
    """

    parts: tuple[ShapePart, ...]
    variance: Float[np.ndarray, "k"]

    @property
    def covariance_mm2(self) -> Float[np.ndarray, "m m"]:
        """Covariance of X, Y and Z of all corners."""
        modes = np.hstack([part.modes for part in self.parts])
        spread = np.repeat(self.variance, [part.modes.shape[1] for part in self.parts])
        return (modes * spread) @ modes.T

    @property
    def information(self) -> Float[np.ndarray, "m m"]:
        """Inverse of the covariance."""
        inverse = np.linalg.inv(self.covariance_mm2)
        return 0.5 * (inverse + inverse.T)

    def update(
        self, shape_mm: Float[np.ndarray, "n 3"], covariance_mm2: Float[np.ndarray, "m m"]
    ) -> "ShapePrior":
        """The prior after one step of expectation and maximisation.

        shape_mm, covariance_mm2 : posterior mean and covariance of the shape under this prior.

        Source: Dempster, Laird and Rubin, "Maximum likelihood from incomplete data via the EM
        algorithm" (1977), for components of variance.
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
        """Effective number of shape parameters that the images determine, given the posterior
        covariance of the shape."""
        return float(len(covariance_mm2) - np.sum(self.information * covariance_mm2))


def shape_prior(
    target: AbstractTarget, spread_mm: float, tuning: CalibTuning = TUNING
) -> ShapePrior:
    """The prior of a board, or of a set of boards, before any image.

    spread_mm : standard deviation of single corners, and of each smooth amplitude, to start from.
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
    every = np.eye(3 * len(target))
    is_height = np.arange(3 * len(target)) % 3 == 2
    for name, columns in (("corner plane", ~is_height), ("corner height", is_height)):
        parts.append(ShapePart(name, every[:, columns], True))
        variance.append(spread_mm**2)
    return ShapePrior(tuple(parts), np.array(variance))


def _smooth_parts(
    xy_mm: Float[np.ndarray, "n 2"], first: int, total: int
) -> dict[str, Float[np.ndarray, "_ _w"]]:
    """Smooth displacements of one board, by part; its corners begin with `first` of `total`.

    Polynomials have a root mean square of 1 mm over the corners, `twist` one of 1 mm at the board's
    edges, `shear` a unit of displacement per unit of length.
    """
    count = len(xy_mm)
    middle = 0.5 * (xy_mm.max(axis=0) + xy_mm.min(axis=0))
    u, v = ((xy_mm - middle) / np.maximum(np.ptp(xy_mm, axis=0) / 2, 1e-9)).T

    def powers(degree: int) -> Float[np.ndarray, "n _"]:
        return np.stack([u**k * v ** (d - k) for d in range(degree + 1) for k in range(d + 1)], 1)

    def place(displacement_mm: Float[np.ndarray, "n 3 w"]) -> Float[np.ndarray, "_ w"]:
        whole = np.zeros((total, 3, displacement_mm.shape[-1]))
        whole[first : first + count] = displacement_mm
        return whole.reshape(3 * total, -1)

    height, plane = powers(_HEIGHT_DEGREE), powers(_PLANE_DEGREE)
    # Constant and slopes tilt the board; the squares along its sides are the sheet's own warps.
    lower = np.concatenate([height[:, :3], (u * u)[:, None], (v * v)[:, None]], axis=1)
    twist = np.zeros((count, 3, 1))
    twist[:, 2, 0] = u * v
    higher = _orthogonal(np.concatenate([lower, twist[:, 2], height[:, 6:]], axis=1), 6)
    heights = np.zeros((count, 3, higher.shape[1]))
    heights[:, 2] = higher
    bent = _orthogonal(plane, 3)
    planes = np.zeros((count, 3, 2 * bent.shape[1]))
    planes[:, 0, : bent.shape[1]] = planes[:, 1, bent.shape[1] :] = bent
    shear = np.zeros((count, 3, 1))
    shear[:, :2, 0] = 0.5 * (xy_mm - middle)[:, ::-1]
    return {
        "shear": place(shear),
        "twist": place(twist),
        "height": place(heights),
        "plane": place(planes),
    }


def _orthogonal(columns: Float[np.ndarray, "n k"], skipped: int) -> Float[np.ndarray, "n _w"]:
    """Columns after the first `skipped`, orthogonal to all before them, of root mean square 1."""
    basis, triangle = np.linalg.qr(columns)
    size = np.abs(np.diag(triangle))
    kept = size > _DEPENDENT * size.max()
    kept[:skipped] = False
    return basis[:, kept] * np.sqrt(len(columns))
