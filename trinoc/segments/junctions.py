"""Junctions and collinear chains of segments, of any detector."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.segments import BODY, Junctions, Segments
from trinoc.numerics.joins import distinct, group_labels, point_tree
from trinoc.numerics.vectors import cross_2d
from trinoc.segments.nevatia_babu.endpoints import (
    NearEnds,
    Pieces,
    endpoint_crossings,
    lines_near_ends,
)
from trinoc.segments.tuning import DEFAULT, SegmentEndTuning


def with_junctions(
    segments: Segments,
    near_ends: NearEnds | None = None,
    tuning: SegmentEndTuning = DEFAULT.junctions,
) -> Segments:
    """Return the segments with their junctions and chains computed.

    `near_ends` is as in `find_junctions`.
    """
    return eqx.tree_at(
        lambda s: (s.junctions, s.chain),
        segments,
        (find_junctions(segments, near_ends, tuning), collinear_chains(segments, tuning)),
        is_leaf=lambda leaf: leaf is None,
    )


def find_junctions(
    segments: Segments,
    near_ends: NearEnds | None = None,
    tuning: SegmentEndTuning = DEFAULT.junctions,
) -> Junctions:
    """Compute the points of an image where segments meet: two ends, or an end and a middle part.

    Parameters
    ----------
    segments : Segments
        Segments of one image.
    near_ends : NearEnds, optional
        Pairs of an end and a line to test. Default: all ends and lines that are near each other.
    tuning : SegmentEndTuning
        Distances and angles.

    Returns
    -------
    Junctions
        Positions with covariance, kinds (L, T, Y, X), and the segments of each junction.

    Notes
    -----
    The end of a segment meets another segment under two conditions. Their lines cross near the end:
    within three of its sigmas along its segment, at most 8 px. The crossing lies on the other
    segment or is as near to one of its ends. Ends that meet, directly or through a third end, form
    one junction.
    """
    ends = np.asarray(segments.endpoints_px, dtype=np.float64)
    count = len(ends)
    pieces = _cut_pieces(ends)
    across, along = _sigmas(segments, pieces.direction)
    radius_px = np.minimum(tuning.sigmas * along, tuning.most_reach_px)
    if near_ends is None:
        near_ends = lines_near_ends(pieces, float(radius_px.max(initial=0.0)))
    line, side, other, _, other_position, _ = endpoint_crossings(pieces, radius_px, near_ends)
    # The end of the other segment near the crossing, or its body.
    to_end = np.abs(other_position[:, None] - pieces.extent_px[other])
    at_end = to_end < radius_px[other][:, None]
    other_end = np.where(at_end.any(axis=1), np.argmin(to_end, axis=1), BODY)

    both_ends = other_end != BODY
    node, other_node = 2 * line + side, 2 * other + other_end
    group = group_labels(2 * count, node[both_ends], other_node[both_ends])
    met = distinct(np.concatenate([node, other_node[both_ends]]))
    body = ~both_ends
    # One key for (group, segment, end), with the same order; a body sorts before the ends.
    keys = np.concatenate(
        [
            (group[met] * count + met // 2) * 3 + 1 + met % 2,
            (group[node[body]] * count + other[body]) * 3,
        ]
    )
    group_and_segment, end = np.divmod(distinct(keys), 3)
    end = np.where(end == 0, BODY, end - 1)
    return _assemble(*np.divmod(group_and_segment, count), end, pieces, across, tuning)


def collinear_chains(
    segments: Segments, tuning: SegmentEndTuning = DEFAULT.junctions
) -> Int[np.ndarray, "n"]:
    """Return the index of the chain that each segment belongs to, (n,).

    A chain consists of collinear pieces of one edge with gaps between them. Two pieces belong
    together if the gap is at most 30 px and shorter than the longer piece. Their directions differ
    by less than four degrees. Each facing end lies on the line of the other piece within three
    sigmas. Known polarities must be equal.
    """
    ends = np.asarray(segments.endpoints_px, dtype=np.float64)
    pieces = _cut_pieces(ends)
    direction, length = pieces.direction, pieces.length_px
    across, _ = _sigmas(segments, direction)
    pairs = point_tree(ends.reshape(-1, 2)).query_pairs(tuning.chain_gap_px, output_type="ndarray")
    outward = np.stack([-direction, direction], axis=1).reshape(-1, 2)
    out_u, out_v = (column.astype(np.float32) for column in outward.T)
    first, second = pairs.T
    # Nearly all pairs fail this test, so it comes first.
    facing = out_u[first] * out_u[second] + out_v[first] * out_v[second] < -np.cos(
        np.radians(tuning.chain_deg)
    )
    facing = np.flatnonzero(facing)
    first, second = first[facing], second[facing]
    (one, side), (other, other_side) = np.divmod(first, 2), np.divmod(second, 2)
    outward, other_outward = outward[first], outward[second]
    gap = ends[other, other_side] - ends[one, side]
    distance = np.linalg.norm(gap, axis=-1)
    sigma = tuning.sigmas * np.hypot(across[one], across[other]) + 0.5
    polarity = np.asarray(segments.polarity) * 1
    # Two pieces with the same direction face each other with different ends.
    agree = polarity[one] * polarity[other] * np.where(side == other_side, -1, 1) >= 0
    continues = (
        (one != other)
        & agree
        & ((gap * outward).sum(axis=-1) > -1.0)
        & (np.abs(cross_2d(gap, outward)) < sigma)
        & (np.abs(cross_2d(gap, other_outward)) < sigma)
        & (distance < np.maximum(length[one], length[other]))
    )
    return group_labels(len(ends), one[continues], other[continues])


def _cut_pieces(ends: Float[np.ndarray, "n 2 2"]) -> Pieces:
    centre = ends.mean(axis=1)
    offset = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(offset, axis=-1, keepdims=True)
    return Pieces(centre, offset / length, length * np.array([-0.5, 0.5]))


def _sigmas(
    segments: Segments, direction: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return the sigma of each segment's ends across and along the segment, (n,) px each.

    Of the two ends, the larger sigma is used.
    """
    covariance = np.asarray(segments.covariance_px2)
    u, v = direction.T
    across, along = (
        np.maximum(
            *(
                a * a * covariance[:, k, k]
                + 2 * a * b * covariance[:, k, k + 1]
                + b * b * covariance[:, k + 1, k + 1]
                for k in (0, 2)
            )
        )
        for a, b in ((-v, u), (u, v))
    )
    return np.sqrt(np.maximum(across, 0.0)), np.sqrt(np.maximum(along, 0.0))


def _assemble(
    group: Int[np.ndarray, "m"],
    segment: Int[np.ndarray, "m"],
    end: Int[np.ndarray, "m"],
    pieces: Pieces,
    across: Float[np.ndarray, "n"],
    tuning: SegmentEndTuning,
) -> Junctions:
    """Build the junctions from their members.

    A member is one end of a segment, or BODY for its middle part. `group` is the junction of each
    member, sorted.
    """
    centre, direction, _ = pieces
    begins = np.diff(group, prepend=-1) != 0
    junction, earliest = np.cumsum(begins) - 1, np.flatnonzero(begins)
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)[segment]
    weight = 1 / np.square(np.maximum(across[segment], 1e-3))
    information = np.add.reduceat(
        weight[:, None, None] * normal[:, :, None] * normal[:, None, :], earliest, axis=0
    )
    # Positions relative to a line of the junction, so that the sums keep their digits.
    origin = centre[segment[earliest]]
    offset = ((centre[segment] - origin[junction]) * normal).sum(axis=-1)
    pulled = np.add.reduceat((weight * offset)[:, None] * normal, earliest, axis=0)
    covariance = np.linalg.inv(information)
    uv_px = origin + np.einsum("jab,jb->ja", covariance, pulled)
    inward = direction[segment] * np.where(end == 0, 1, -1)[:, None]
    kind = _kinds(junction, end, inward, len(earliest), tuning.straight_deg)
    return Junctions(uv_px, covariance, kind, junction, segment, end)


def _kinds(
    junction: Int[np.ndarray, "m"],
    end: Int[np.ndarray, "m"],
    inward: Float[np.ndarray, "m 2"],
    count: int,
    straight_deg: float,
) -> np.ndarray:
    """Return the kind of each junction: "L", "Y", "X" or "T".

    The kind depends on the numbers of ends and of middle parts, and on whether two ends are
    collinear. `inward` is the direction from the junction into each segment.
    """
    ends = np.bincount(junction[end != BODY], minlength=count)
    bodies = np.bincount(junction[end == BODY], minlength=count)
    straight = np.zeros(count, dtype=bool)
    straight[_with_opposite_ends(junction, end, inward, straight_deg)] = True
    code = np.clip(ends - 2, 0, 2)
    code[(bodies > 0) | (straight & (ends == 3))] = 3
    return np.array(["L", "Y", "X", "T"])[code]


def _with_opposite_ends(
    junction: Int[np.ndarray, "m"],
    end: Int[np.ndarray, "m"],
    inward: Float[np.ndarray, "m 2"],
    straight_deg: float,
) -> Int[np.ndarray, "k"]:
    """Return the junctions at which two segments leave in opposite directions, (k,)."""
    rows = np.flatnonzero(end != BODY)
    size = np.bincount(junction[rows])
    hits: list[np.ndarray] = []
    # Rows are sorted by junction: partners are at most the largest junction's size away.
    for step in range(1, int(size.max(initial=1))):
        first, second = rows[:-step], rows[step:]
        same: Bool[np.ndarray, "k"] = junction[first] == junction[second]
        opposite = (inward[first] * inward[second]).sum(axis=-1) < -np.cos(np.radians(straight_deg))
        hits.append(junction[first[same & opposite]])
    return np.concatenate([np.zeros(0, dtype=np.int64), *hits])
