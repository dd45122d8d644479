"""Ends of segments: carried to the crossing with the edge that stops them."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

_SAMPLE_PX = 3.0
_NEIGHBOURS = 12
_LEAST_SINE = np.sin(np.radians(15.0))


def crossings_near_ends(
    centre_px: Float[np.ndarray, "r 2"],
    direction: Float[np.ndarray, "r 2"],
    extent_px: Float[np.ndarray, "r 2"],
    reach_px: float,
) -> tuple[Int[np.ndarray, "r 2"], Float[np.ndarray, "r 2"]]:
    """(partner, position): the line that each end meets, -1 for none, and where on the own line.

    An end meets another line where both cross at more than fifteen degrees, within `reach_px`
    of the end along its own line, and on the other line or within `reach_px` of its ends. Of
    several, the crossing nearest to the end counts.
    """
    count = len(centre_px)
    partner = np.full((count, 2), -1, dtype=np.int64)
    position = extent_px.copy()
    if count < 2:
        return partner, position
    owner, samples = line_samples(centre_px, direction, extent_px, _SAMPLE_PX)
    ends = centre_px[:, None] + extent_px[:, :, None] * direction[:, None]
    _, near = KDTree(samples).query(
        ends.reshape(-1, 2), k=_NEIGHBOURS, distance_upper_bound=reach_px * 1.5
    )
    end, slot = np.nonzero(near < len(samples))
    other = owner[near[end, slot]]
    line, side = np.divmod(end, 2)
    between = centre_px[other] - centre_px[line]
    sine = _cross(direction[line], direction[other])
    steep = np.abs(sine) > _LEAST_SINE
    line, side, other, between, sine = (
        values[steep] for values in (line, side, other, between, sine)
    )
    own_position = _cross(between, direction[other]) / sine
    other_position = _cross(between, direction[line]) / sine
    shift = np.abs(own_position - extent_px[line, side])
    on_other = (other_position > extent_px[other, 0] - reach_px) & (
        other_position < extent_px[other, 1] + reach_px
    )
    # The crossing may not swallow the segment from its other end.
    far = np.abs(own_position - extent_px[line, 1 - side])
    allowed = (shift < reach_px) & on_other & (far > shift)
    line, side, other, own_position, shift = (
        values[allowed] for values in (line, side, other, own_position, shift)
    )
    farthest_first = np.argsort(-shift, kind="stable")
    line, side = line[farthest_first], side[farthest_first]
    partner[line, side] = other[farthest_first]
    position[line, side] = own_position[farthest_first]
    return partner, position


def line_samples(
    centre_px: Float[np.ndarray, "r 2"],
    direction: Float[np.ndarray, "r 2"],
    extent_px: Float[np.ndarray, "r 2"],
    spacing_px: float,
) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m 2"]]:
    """(owner, samples): points along every line, ends included, at most `spacing_px` apart."""
    length = np.ptp(extent_px, axis=1)
    count = np.ceil(length / spacing_px).astype(np.int64) + 1
    owner = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    along = extent_px[owner, 0] + length[owner] * step / np.maximum(count[owner] - 1, 1)
    return owner, centre_px[owner] + along[:, None] * direction[owner]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
