"""Pairs of segments that can be one line: those of two views that share epipolar planes."""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates import Candidates
from trinoc.match.evidence import PairEvidence, pair_evidence, polarity_evidence, side_evidence
from trinoc.match.observations import (
    TRIPLES_IN_BLOCK,
    ClutterModel,
    SegmentTable,
    block_of,
    clutter_of,
)
from trinoc.match.tuning import CandidateTuning, EndTuning, MatchTuning
from trinoc.match.two_view import Pencil, pencil, pencil_of, plane_angles, row_of
from trinoc.numerics import ArrayLike, blocks, in_blocks, kept_jit, overlapping, stacked

# About as many pairs are held at a time.
PAIRS_AT_A_TIME = 1 << 17


class PossiblePairs(NamedTuple):
    """Pairs that can be one line, and in how many other views each should be seen."""

    candidates: Candidates
    expected: Float[np.ndarray, "m"]


def possible_pairs(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    free: list[Int[np.ndarray, "_"]],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> Iterator[PossiblePairs]:
    """All pairs of free segments of two views that can be one line, block by block."""
    planes, own_free = pencil(lines, views[0], views[1]), [free[view] for view in views]
    low_high = [
        plane_angles(lines, int(view), segments)
        for view, segments in zip(views, (planes.first, planes.second), strict=True)
    ]
    first, second = (angles[own] for angles, own in zip(low_high, own_free, strict=True))
    frames = 1 if lines.frame is None else len(lines.matrix_px)
    # About one in four pairs of a frame shares epipolar planes.
    rows = max(1, 4 * PAIRS_AT_A_TIME * frames // max(len(second), 1))
    for block in blocks(len(first), rows):
        i, j = overlapping(first[block], second)
        segments = np.stack([own_free[0][i + block.start], own_free[1][j]], axis=1)
        yield _judged(lines, views, planes, segments, clutter, tuning)


def _judged(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    planes: Pencil,
    segments: Int[np.ndarray, "p 2"],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> PossiblePairs:
    def judged(segments: np.ndarray) -> PairEvidence:
        groups = {"tuning": tuning.candidates, "ends": tuning.ends}
        return _evidence_of(lines, views, planes, segments, clutter, **groups)

    found = in_blocks(judged, block_of(lines, TRIPLES_IN_BLOCK), segments)
    keep = np.flatnonzero(found.possible)
    polarity = np.asarray(lines.polarity)
    index = np.full((len(keep), len(lines.ends_px)), -1)
    interval = np.zeros((len(keep), len(lines.ends_px), 2))
    index[:, views], interval[:, views] = segments[keep], stacked(found.interval, keep)
    candidates = Candidates(
        index,
        interval,
        stacked(found.ends_mm, keep),
        np.zeros(len(keep)),
        np.asarray(found.log_density)[keep]
        + polarity_evidence(polarity, index, interval, tuning.evidence),
        stacked(found.end_log, keep),
        stacked(found.union_ends_mm, keep),
        stacked(found.union_covariance_mm2, keep),
        np.asarray(found.px_per_mm)[keep],
        side_evidence(np.asarray(lines.sides), index, interval, tuning.sides),
    )
    return PossiblePairs(candidates, np.asarray(found.expected)[keep])


@partial(kept_jit, static_argnames=("tuning", "ends"))
def _evidence_of(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    pairs: Int[ArrayLike, "h 2"],
    clutter: ClutterModel,
    tuning: CandidateTuning,
    ends: EndTuning,
) -> PairEvidence:
    segments = jnp.asarray(pairs).T
    rows = row_of(planes.first, segments[0]), row_of(planes.second, segments[1])
    among = clutter_of(clutter, lines, views[0], segments[0])
    of_pencil = pencil_of(planes, lines, views[0], segments[0])
    return pair_evidence(lines, views, of_pencil, rows, segments, among, tuning, ends)
