"""Points of one picture where segments meet."""

import equinox as eqx
from jaxtyping import Float, Int, Shaped

from trinoc.numerics import ArrayLike

# The body of a segment, not one of its ends, lies on a junction.
BODY = -1


class Junctions(eqx.Module):
    """Where segments of one picture meet, and which of them do.

    The last three fields are one table with a row for each segment at each junction.

    Fields
    ------
    uv_px : (j, 2) the point nearest to all lines that meet, weighted by their sigmas.
    covariance_px2 : (j, 2, 2) of that point.
    kind : (j,) "L" (two ends), "Y" (three), "T" (an end on a body, or three ends of which two
        are collinear), "X" (four ends or more).
    junction : (m,) junction of each row.
    segment : (m,) segment of each row.
    end : (m,) 0 or 1, the end of the segment that meets, or -1 for its body.
    """

    uv_px: Float[ArrayLike, "j 2"]
    covariance_px2: Float[ArrayLike, "j 2 2"]
    kind: Shaped[ArrayLike, "j"]
    junction: Int[ArrayLike, "m"]
    segment: Int[ArrayLike, "m"]
    end: Int[ArrayLike, "m"]

    def __len__(self) -> int:
        return len(self.uv_px)
