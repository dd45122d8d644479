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
    """Straight pieces of lines in an image.

    Attributes
    ----------
    centre_px : (r, 2)
        A point of each line.
    direction : (r, 2)
        Unit vector along the line.
    extent_px : (r, 2)
        Positions of the two ends along `direction`, measured from `centre_px`.
    """

    centre_px: Float[np.ndarray, "r 2"]
    direction: Float[np.ndarray, "r 2"]
    extent_px: Float[np.ndarray, "r 2"]

    @property
    def ends_px(self) -> Float[np.ndarray, "r 2 2"]:
        """The two ends of each piece, (r, 2, 2)."""
        return self.centre_px[:, None] + self.extent_px[:, :, None] * self.direction[:, None]

    @property
    def length_px(self) -> Float[np.ndarray, "r"]:
        """Length of each piece, (r,)."""
        return self.extent_px[:, 1] - self.extent_px[:, 0]


class EndpointCrossings(NamedTuple):
    """Crossings of a line with another line near one of its ends, sorted by decreasing distance.

    Attributes
    ----------
    line, side : (m,)
        The line, and its end near the crossing, 0 or 1.
    other : (m,)
        The other line.
    position : (m,)
        Position of the crossing along the line, px from its centre.
    other_position : (m,)
        Position of the crossing along the other line, px from its centre.
    distance_px : (m,)
        Distance between the end and the crossing.
    """

    line: Int[np.ndarray, "m"]
    side: Int[np.ndarray, "m"]
    other: Int[np.ndarray, "m"]
    position: Float[np.ndarray, "m"]
    other_position: Float[np.ndarray, "m"]
    distance_px: Float[np.ndarray, "m"]


class NearEnds(NamedTuple):
    """Pairs of a line end and another line nearby, as indices (p,) of both.

    Line k has the ends 2 k and 2 k + 1.
    """

    end: Int[np.ndarray, "p"]
    line: Int[np.ndarray, "p"]


def lines_near_ends(pieces: Pieces, radius_px: float) -> NearEnds:
    """List the lines within twice `radius_px` of each line end, at most twelve for each end."""
    count = len(pieces.centre_px)
    owner, samples = line_samples(pieces, SAMPLE_PX)
    end, sample, _ = near_pairs(pieces.ends_px.reshape(-1, 2), samples, 2 * radius_px, _NEIGHBOURS)
    # Most samples near an end belong to its own line.
    other_lines = np.flatnonzero(owner[sample] != end // 2)
    pair = distinct(end[other_lines] * count + owner[sample[other_lines]])
    return NearEnds(*np.divmod(pair, max(count, 1)))


def endpoint_crossings(
    pieces: Pieces,
    radius_px: Float[np.ndarray, "r"],
    near_ends: NearEnds,
    tuning: EndpointTuning = DEFAULT.ends,
) -> EndpointCrossings:
    """Compute the crossings near line ends, for the pairs in `near_ends` that are not parallel.

    Each line has its own limit `radius_px` for the position of the crossing along the line. For the
    first line, the limit applies to the distance from the end. For the other line, the limit
    applies to the distance from the nearest point of the line.
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
    other_radius_px = radius_px[other]
    allowed = np.flatnonzero(
        (shift < radius_px[line])
        & (other_shift > shift)
        & (other_position > extent_px[other, 0] - other_radius_px)
        & (other_position < extent_px[other, 1] + other_radius_px)
    )
    allowed = allowed[np.argsort(-shift[allowed], kind="stable")]
    return EndpointCrossings(
        *take_rows((line, side, other, position, other_position, shift), allowed)
    )


def snap_ends(
    pieces: Pieces, radius_px: float, near_ends: NearEnds, tuning: EndpointTuning = DEFAULT.ends
) -> tuple[Int[np.ndarray, "r 2"], Float[np.ndarray, "r 2"]]:
    """Find the crossing line nearest to each line end, within `radius_px`.

    Returns the crossing line (r, 2), -1 if there is none, and the new position of the end (r, 2).
    Positions are along the line from its centre, px. Only the pairs in `near_ends` are tested.
    """
    partner = np.full(pieces.extent_px.shape, -1, dtype=np.int64)
    position = pieces.extent_px.copy()
    crossings = endpoint_crossings(pieces, np.full(len(partner), radius_px), near_ends, tuning)
    # Of several crossings of one end, the last one written is the nearest.
    partner[crossings.line, crossings.side] = crossings.other
    position[crossings.line, crossings.side] = crossings.position
    return partner, position


def end_sigmas(
    contrast: Float[np.ndarray, "r"],
    partner: Int[np.ndarray, "r 2"],
    tuning: EndpointTuning = DEFAULT.ends,
) -> Float[np.ndarray, "r 2"]:
    """Return the standard deviation of each end along its line, (r, 2) px.

    An end with a `partner` is the crossing with that line. Other ends are less precise, because the
    edge may continue below the noise. Their sigma decreases with the contrast.
    """
    free = tuning.sigma_free_px / np.sqrt(np.maximum(contrast, 1e-6))
    free = np.minimum(free, tuning.most_free_px)[:, None]
    return np.where(partner >= 0, tuning.sigma_crossing_px, free)


def line_samples(
    pieces: Pieces, spacing_px: float
) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m 2"]]:
    """Return points along every line, ends included, at most `spacing_px` apart.

    The first result is the line of each point (m,), the second the points (m, 2).
    """
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
