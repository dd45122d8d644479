"""What the values of columns must be."""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.numerics.tables import ColumnCheck

# Larger numbers are no places: no picture has so many pixels, no scene so many mm.
LARGEST_PX, LARGEST_MM = 1e6, 1e9
# Of correlations: what rounding leaves of a covariance without spread in some direction.
_LEAST_EIGENVALUE = -1e-6
_ROUNDING = 1e-9

IN_SCENE = ColumnCheck(
    "is not finite or beyond all scenes", lambda values, _: np.abs(values) < LARGEST_MM
)
IN_PICTURE = ColumnCheck(
    "is not finite or beyond all pictures", lambda values, _: np.abs(values) < LARGEST_PX
)
PICTURE_SIZE = ColumnCheck(
    "must be a width and a height in pixels",
    lambda size, _: len(size) == 2 and all(0 < side < LARGEST_PX for side in size),
)
RADIUS = ColumnCheck("is no radius", lambda values, _: (values > 0) & (values < LARGEST_MM))
FINITE = ColumnCheck("is not finite", lambda values, _: np.isfinite(values))
NOT_INFINITE = ColumnCheck("is infinite", lambda values, _: ~np.isinf(values))
NOT_NEGATIVE = ColumnCheck("is negative", lambda values, _: values >= 0)
SEGMENT_NUMBER = ColumnCheck("is no segment", lambda values, _: values >= 0)
PROBABILITY = ColumnCheck(
    "is no probability", lambda values, _: (values >= 0) & (values <= 1 + _ROUNDING)
)
CHI_SQUARE = ColumnCheck("is no chi-square", lambda values, _: ~(values < 0) & ~np.isinf(values))
COVARIANCE = ColumnCheck("is no covariance", lambda values, _: is_covariance(values))


def check_number(side: str, problem: str, *, least: int = 0) -> ColumnCheck:
    """A row along a side, or -1 for none where `least` is."""
    return ColumnCheck(
        problem, lambda values, table: (values >= least) & (values < table.sides[side])
    )


def is_covariance(matrices: Float[np.ndarray, "n k k"]) -> Bool[np.ndarray, "n"]:
    """(n,) whether each of (n, k, k) is finite, symmetric and without negative variance."""
    good = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    trusted = np.where(good[:, None, None], matrices, 0.0)
    variance = np.diagonal(trusted, axis1=1, axis2=2)
    sigma = np.sqrt(np.where(variance > 0, variance, 1.0))
    # As correlations, so that degrees and millimetres count alike.
    unit = trusted / sigma[:, :, None] / sigma[:, None, :]
    good &= (variance >= 0).all(axis=1) & (np.abs(unit) < 2).all(axis=(1, 2))
    unit = np.where(good[:, None, None], unit, 0.0)
    good &= (np.abs(unit - unit.transpose(0, 2, 1)) < 1e-6).all(axis=(1, 2))
    if unit.size:
        good &= np.linalg.eigvalsh(unit).min(axis=1) >= _LEAST_EIGENVALUE
    return good
