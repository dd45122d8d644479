"""Ends of segments: crossings with the edge that stops them."""

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
    """Pieces of lines, each with a point, a unit direction, and the positions of both ends.

    `extent_px` are the positions of the ends along the direction, from `centre_px`.
    """

    centre_px: Float[np.ndarray, "r 2"]
    direction: Float[np.ndarray, "r 2"]
    extent_px: Float[np.ndarray, "r 2"]

    @property
    def ends_px(self) -> Float[np.ndarray, "r 2 2"]:
        """Two ends of each piece, (r, 2, 2)."""
        return self.centre_px[:, None] + self.extent_px[:, :, None] * self.direction[:, None]

    @property
    def length_px(self) -> Float[np.ndarray, "r"]:
        """Length of each piece, (r,)."""
        return self.extent_px[:, 1] - self.extent_px[:, 0]


class EndpointCrossings(NamedTuple):
    """Crossings of lines near an end of one of them, largest distance first.

    Attributes
    ----------
    line, side : (m,)
        Line, and which of its two ends.
    other : (m,)
        The line that crosses it.
    position : (m,)
        Position of the crossing along the first line, from its centre.
    other_position : (m,)
        Position along the other line.
    distance_px : (m,)
        Distance of the end from the crossing.
    """

    line: Int[np.ndarray, "m"]
    side: Int[np.ndarray, "m"]
    other: Int[np.ndarray, "m"]
    position: Float[np.ndarray, "m"]
    other_position: Float[np.ndarray, "m"]
    distance_px: Float[np.ndarray, "m"]


class NearEnds(NamedTuple):
    """Pairs of an end and a nearby line, as indices (p,). Line k has the ends 2 k and 2 k + 1."""

    end: Int[np.ndarray, "p"]
    line: Int[np.ndarray, "p"]


def lines_near_ends(pieces: Pieces, reach_px: float) -> NearEnds:
    """Lines within twice `reach_px` of each end, where they may cross; at most twelve per end."""
    count = len(pieces.centre_px)
    owner, samples = line_samples(pieces, SAMPLE_PX)
    end, sample, _ = near_pairs(pieces.ends_px.reshape(-1, 2), samples, 2 * reach_px, _NEIGHBOURS)
    # Most samples near an end belong to its own line.
    other_lines = np.flatnonzero(owner[sample] != end // 2)
    pair = distinct(end[other_lines] * count + owner[sample[other_lines]])
    return NearEnds(*np.divmod(pair, max(count, 1)))


def endpoint_crossings(
    pieces: Pieces,
    reach_px: Float[np.ndarray, "r"],
    near_ends: NearEnds,
    tuning: EndpointTuning = DEFAULT.ends,
) -> EndpointCrossings:
    """Crossings near the ends of lines that are not parallel.

    A crossing lies within `reach_px` (of each line) of the end along its line. It also lies on the
    other line, or within the other's reach of its ends. Only the pairs in `near_ends` are tested.
    """
    centre_px, direction, extent_px = pieces
    end, other = near_ends
    line, side = np.divmod(end, 2)
    sine = cross_2d(direction[line], direction[other])
    steep = np.flatnonzero(np.abs(sine) > np.sin(np.radians(tuning.parallel_deg)))
    line, side, other, sine = line[steep], side[steep], other[steep], sine[steep]
    between = centre_px[other] - centre_px[line]
    position = cross_2d(between, direction[other]) / sine
    other_position = cross_2d(between, direction[line]) / sine
    shift = np.abs(position - extent_px[line, side])
    # The crossing must be nearer to this end than to the other one.
    other_shift = np.abs(position - extent_px[line, 1 - side])
    reach = reach_px[other]
    allowed = np.flatnonzero(
        (shift < reach_px[line])
        & (other_shift > shift)
        & (other_position > extent_px[other, 0] - reach)
        & (other_position < extent_px[other, 1] + reach)
    )
    allowed = allowed[np.argsort(-shift[allowed], kind="stable")]
    return EndpointCrossings(
        *take_rows((line, side, other, position, other_position, shift), allowed)
    )


def snap_ends(
    pieces: Pieces, reach_px: float, near_ends: NearEnds, tuning: EndpointTuning = DEFAULT.ends
) -> tuple[Int[np.ndarray, "r 2"], Float[np.ndarray, "r 2"]]:
    """(partner, position): the line that stops each end (-1: none), and the end's new position.

    The nearest crossing within `reach_px` counts. Positions are along the line from its centre.
    `near_ends` are the pairs to test.
    """
    partner = np.full(pieces.extent_px.shape, -1, dtype=np.int64)
    position = pieces.extent_px.copy()
    crossings = endpoint_crossings(pieces, np.full(len(partner), reach_px), near_ends, tuning)
    # Of several crossings of one end, the last one written is the nearest.
    partner[crossings.line, crossings.side] = crossings.other
    position[crossings.line, crossings.side] = crossings.position
    return partner, position


def end_sigmas(
    contrast: Float[np.ndarray, "r"],
    partner: Int[np.ndarray, "r 2"],
    tuning: EndpointTuning = DEFAULT.ends,
) -> Float[np.ndarray, "r 2"]:
    """Standard deviation of each end along its line, (r, 2) px.

    An end with a `partner` lies at a crossing. A free end lies where the evidence stops: the edge
    may continue below the noise, the farther the smaller its contrast.
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
    spacing = length / np.maximum(count - 1, 1)
    begin = centre_px + extent_px[:, :1] * direction
    samples = np.empty((len(owner), 2))
    for axis in (0, 1):
        stride = np.repeat(spacing * direction[:, axis], count)
        samples[:, axis] = np.repeat(begin[:, axis], count) + step * stride
    return owner, samples
