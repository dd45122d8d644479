"""Whether a segment of the third view is near enough to what a pair predicts."""

import jax.numpy as jnp
from jaxtyping import Bool, Float

from trinoc.match.candidates.transfer import Prediction
from trinoc.match.tuning import DEFAULT, CandidateTuning
from trinoc.numerics import ArrayLike, Scalar, between


def passes_third_view_gate(
    prediction: Prediction,
    ends_px: Float[ArrayLike, "2 2"],
    line: Float[ArrayLike, "3"],
    across_px2: Float[ArrayLike, "2 2"],
    tuning: CandidateTuning = DEFAULT.candidates,
) -> Bool[ArrayLike, ""]:
    """Whether a segment overlaps the predicted one, and passes the gate where it does."""
    p = prediction
    du, dv = p.u1 - p.u0, p.v1 - p.v0
    squared = du * du + dv * dv

    def along(e: int) -> Scalar:
        return ((ends_px[e, 0] - p.u0) * du + (ends_px[e, 1] - p.v0) * dv) / squared

    first, second = along(0), along(1)
    begin = jnp.maximum(0.0, jnp.minimum(first, second))
    end = jnp.minimum(1.0, jnp.maximum(first, second))
    reach = second - first
    overlaps = end - begin > tuning.smallest_overlap * jnp.minimum(1.0, jnp.abs(reach))

    off0 = line[0] * p.u0 + line[1] * p.v0 + line[2]
    off1 = line[0] * p.u1 + line[1] * p.v1 + line[2]
    r0, r1 = off0 + begin * (off1 - off0), off0 + end * (off1 - off0)
    predicted = (p.c00, p.c01, p.c11)
    own = (across_px2[0, 0], across_px2[0, 1], across_px2[1, 1])
    s, t = (begin - first) / reach, (end - first) / reach
    v00 = between(predicted, begin, begin) + between(own, s, s)
    v11 = between(predicted, end, end) + between(own, t, t)
    v01 = between(predicted, begin, end) + between(own, s, t)
    determinant = v00 * v11 - v01 * v01
    chi_square = (v11 * r0 * r0 - 2 * v01 * r0 * r1 + v00 * r1 * r1) / determinant
    return p.possible & overlaps & (chi_square < tuning.gate_slack * tuning.gate)
