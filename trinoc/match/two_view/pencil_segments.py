"""The segments of one view in a pencil, as rows of one table."""

from typing import NamedTuple

from jaxtyping import Float, Int

from trinoc.numerics import ArrayLike, Scalar, Vector3, namespace_of

_SLOPE_VARIANCES = (11, 12, 13)


class PencilSegments(NamedTuple):
    """The segments of one view in a pencil.

    columns : one row per quantity, in the order of what follows: kernels take and index one array.
    """

    columns: Float[ArrayLike, "16 *n"]

    @property
    def low(self) -> Scalar:
        """Plane angle of one end, in rad, without a jump before `high`."""
        return self.columns[0]

    @property
    def high(self) -> Scalar:
        """Plane angle of the other end, the larger."""
        return self.columns[1]

    @property
    def cosine_low(self) -> Scalar:
        """Cosine of `low`."""
        return self.columns[2]

    @property
    def sine_low(self) -> Scalar:
        """Sine of `low`."""
        return self.columns[3]

    @property
    def cosine_high(self) -> Scalar:
        """Cosine of `high`."""
        return self.columns[4]

    @property
    def sine_high(self) -> Scalar:
        """Sine of `high`."""
        return self.columns[5]

    @property
    def p(self) -> Scalar:
        """Of the slope, p cos + q sin."""
        return self.columns[6]

    @property
    def q(self) -> Scalar:
        """Of the slope, p cos + q sin."""
        return self.columns[7]

    @property
    def normal(self) -> Vector3:
        """Of the interpretation plane, of unit length."""
        return self.columns[8], self.columns[9], self.columns[10]

    @property
    def slope_variance(self) -> Vector3:
        """(c00, c01, c11) of the slopes at the angles low and high, due to the errors of the ends
        across the segment."""
        low, both, high = _SLOPE_VARIANCES
        return self.columns[low], self.columns[both], self.columns[high]

    @property
    def end_variance_px2(self) -> tuple[Scalar, Scalar]:
        """Of the places along the segment, at low and high, that have the plane angles of a
        partner's ends."""
        return self.columns[14], self.columns[15]

    def with_slope_error(self, variance: Scalar) -> "PencilSegments":
        """With an error of the slope at either end beside the others."""
        rows = list(self.columns)
        for row in (_SLOPE_VARIANCES[0], _SLOPE_VARIANCES[-1]):
            rows[row] = rows[row] + variance
        return PencilSegments(namespace_of(rows[0]).stack(rows))


def row_of(table: PencilSegments, index: Int[ArrayLike, "*p"]) -> PencilSegments:
    """The segments of given numbers."""
    return PencilSegments(table.columns[:, index])
