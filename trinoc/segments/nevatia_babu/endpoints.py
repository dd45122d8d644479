"""Ends of segments: carried to the crossing with the edge that stops them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.joins import distinct, near_pairs
from trinoc.numerics.tables import take_rows
from trinoc.numerics.vectors import cross_2d
from trinoc.segments.tuning import DEFAULT, EndpointTuning

SAMPLE_PX = 3.0  # numerical: spacing of samples on lines for a search
_NEIGHBOURS = 12  # numerical: bounds a search


class Pieces(NamedTuple):
    """Pieces of lines: a place on each, its unit direction, and both ends along it from there."""

    centre_px: Float[np.ndarray, "r 2"]
    direction: Float[np.ndarray, "r 2"]
    extent_px: Float[np.ndarray, "r 2"]

    @property
    def ends_px(self) -> Float[np.ndarray, "r 2 2"]:
        """(r, 2, 2) the two ends of each."""
        return self.centre_px[:, None] + self.extent_px[:, :, None] * self.direction[:, None]

    @property
    def length_px(self) -> Float[np.ndarray, "r"]:
        """(r,) the length of each."""
        return self.extent_px[:, 1] - self.extent_px[:, 0]


class EndpointCrossings(NamedTuple):
    """Ends that come near other lines, the farthest from its crossing first.

    Fields
    ------
    line, side : (m,) the line and which of its two ends.
    other : (m,) the line that it meets.
    position : (m,) where the two cross, along the first line from its centre.
    other_position : (m,) and along the other.
    distance_px : (m,) of the end from the crossing.
    """

    line: Int[np.ndarray, "m"]
    side: Int[np.ndarray, "m"]
    other: Int[np.ndarray, "m"]
    position: Float[np.ndarray, "m"]
    other_position: Float[np.ndarray, "m"]
    distance_px: Float[np.ndarray, "m"]


class NearEnds(NamedTuple):
    """Pairs of an end and a line that it comes near: (p,) indices. Line k has ends 2 k, 2 k + 1."""

    end: Int[np.ndarray, "p"]
    line: Int[np.ndarray, "p"]


def lines_near_ends(pieces: Pieces, reach_px: float) -> NearEnds:
    """The lines, at most some, within twice the reach of each end: where they may cross."""
    count = len(pieces.centre_px)
    owner, samples = line_samples(pieces, SAMPLE_PX)
    end, sample, _ = near_pairs(pieces.ends_px.reshape(-1, 2), samples, 2 * reach_px, _NEIGHBOURS)
    # Most samples near an end are its own line's.
    foreign = np.flatnonzero(owner[sample] != end // 2)
    pair = distinct(end[foreign] * count + owner[sample[foreign]])
    return NearEnds(*np.divmod(pair, max(count, 1)))


def endpoint_crossings(
    pieces: Pieces,
    reach_px: Float[np.ndarray, "r"],
    near: NearEnds,
    tuning: EndpointTuning = DEFAULT.ends,
) -> EndpointCrossings:
    """Where ends meet other lines: crossings near the end of lines that are not parallel.

    A crossing counts within `reach_px` (of each line) of the end along its own line, and on
    the other line or within the other's reach of its ends. Only the pairs in `near` are
    looked at.
    """
    centre_px, direction, extent_px = pieces
    end, other = near
    line, side = np.divmod(end, 2)
    sine = cross_2d(direction[line], direction[other])
    steep = np.flatnonzero(np.abs(sine) > np.sin(np.radians(tuning.parallel_deg)))
    line, side, other, sine = line[steep], side[steep], other[steep], sine[steep]
    between = centre_px[other] - centre_px[line]
    position = cross_2d(between, direction[other]) / sine
    other_position = cross_2d(between, direction[line]) / sine
    shift = np.abs(position - extent_px[line, side])
    # The crossing may not swallow the segment from its other end.
    far = np.abs(position - extent_px[line, 1 - side])
    reach = reach_px[other]
    allowed = np.flatnonzero(
        (shift < reach_px[line])
        & (far > shift)
        & (other_position > extent_px[other, 0] - reach)
        & (other_position < extent_px[other, 1] + reach)
    )
    allowed = allowed[np.argsort(-shift[allowed], kind="stable")]
    return EndpointCrossings(
        *take_rows((line, side, other, position, other_position, shift), allowed)
    )


def snap_ends(
    pieces: Pieces, reach_px: float, near: NearEnds, tuning: EndpointTuning = DEFAULT.ends
) -> tuple[Int[np.ndarray, "r 2"], Float[np.ndarray, "r 2"]]:
    """(partner, position): the line that stops each end, -1 for none, and where along its own.

    Of several crossings within `reach_px` the nearest to the end counts; `near` are the pairs
    to look at.
    """
    partner = np.full(pieces.extent_px.shape, -1, dtype=np.int64)
    position = pieces.extent_px.copy()
    found = endpoint_crossings(pieces, np.full(len(partner), reach_px), near, tuning)
    # Of several that write to one place the last stays.
    partner[found.line, found.side] = found.other
    position[found.line, found.side] = found.position
    return partner, position


def end_sigmas(
    contrast: Float[np.ndarray, "r"],
    partner: Int[np.ndarray, "r 2"],
    tuning: EndpointTuning = DEFAULT.ends,
) -> Float[np.ndarray, "r 2"]:
    """(r, 2) standard deviation of each end along its line, in px.

    An end with a `partner` is at a crossing. A free end is where the evidence stops: the edge
    goes on unseen into its background, the farther the fainter it is.
    """
    free = tuning.sigma_free_px / np.sqrt(np.maximum(contrast, 1e-6))
    free = np.minimum(free, tuning.most_free_px)[:, None]
    return np.where(partner >= 0, tuning.sigma_crossing_px, free)


def line_samples(
    pieces: Pieces, spacing_px: float
) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m 2"]]:
    """(owner, samples): points along every line, ends included, at most `spacing_px` apart."""
    centre_px, direction, extent_px = pieces
    length = pieces.length_px
    count = np.ceil(length / spacing_px).astype(np.int64) + 1
    owner = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    apart = length / np.maximum(count - 1, 1)
    begin = centre_px + extent_px[:, :1] * direction
    samples = np.empty((len(owner), 2))
    for axis in (0, 1):
        stride = np.repeat(apart * direction[:, axis], count)
        samples[:, axis] = np.repeat(begin[:, axis], count) + step * stride
    return owner, samples
