"""Pairs of segments that can be one line: those of two views that share epipolar planes."""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates import Candidates
from trinoc.match.evidence import pair_evidence, polarity_evidence, side_evidence
from trinoc.match.observations import (
    TRIPLES_IN_BLOCK,
    ClutterModel,
    SegmentTable,
    block_of,
)
from trinoc.match.occlusion.likely_pairs import PairBound, may_be_likely
from trinoc.match.tuning import CandidateTuning, EndTuning, MatchTuning
from trinoc.match.two_view import Pencil, pairs_sharing_planes, pencil, pencil_of, row_of
from trinoc.numerics import (
    ArrayLike,
    as_columns,
    kept_jit,
    select_in_blocks,
    split_columns,
)

# About as many pairs are held at a time.
PAIRS_AT_A_TIME = 1 << 17


class PossiblePairs(NamedTuple):
    """Pairs that can be one line, in how many other views each should be seen, and the sine of the
    angle between its interpretation planes."""

    candidates: Candidates
    expected: Float[np.ndarray, "m"]
    crossing_sine: Float[np.ndarray, "m"]


def possible_pairs(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    free: list[Int[np.ndarray, "_"]],
    clutter: ClutterModel,
    tuning: MatchTuning,
    bound: PairBound | None = None,
    ends_px: float | None = None,
) -> Iterator[PossiblePairs]:
    """All pairs of free segments of two views that can be one line, and may be likely as far as a
    `bound` tells, and of which an end agrees by `ends_px`, if that is given, block by block."""
    planes = pencil(lines, *views.tolist())
    rows = free[views[0]], free[views[1]]
    for pair in pairs_sharing_planes(lines, views, planes, rows, PAIRS_AT_A_TIME, ends_px):
        segments = np.stack(pair, axis=1).astype(np.int64)
        yield _judged(lines, views, planes, segments, clutter, tuning, bound)


def rehearse_pairs(lines: SegmentTable, clutter: ClutterModel, tuning: MatchTuning) -> None:
    """Judge no pairs, which compiles what judges them."""
    nobody = [np.zeros(0, np.int64)] * len(lines.ends_px)
    for _ in possible_pairs(lines, np.arange(2), nobody, clutter, tuning):
        pass


def _judged(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    planes: Pencil,
    segments: Int[np.ndarray, "p 2"],
    clutter: ClutterModel,
    tuning: MatchTuning,
    bound: PairBound | None,
) -> PossiblePairs:
    ends = len(tuning.ends.agreeing_px) + 1
    shapes = ((2, 2), (2, 3), (), (2, ends), (2, 3), (2, 6), (), (), ())

    def judged(segments: np.ndarray) -> tuple[ArrayLike, ArrayLike]:
        groups = {"tuning": tuning.candidates, "ends": tuning.ends}
        possible, columns = _evidence_of(lines, views, planes, segments, clutter, **groups)
        if bound is not None:
            possible = may_be_likely(bound, possible, columns, tuning=tuning.evidence)
        return possible, columns

    keep, columns = select_in_blocks(judged, block_of(lines, TRIPLES_IN_BLOCK), segments)
    of_views, ends_mm, log_density, end_log, *union = split_columns(columns, shapes)
    outer_mm, spread, px_per_mm, expected, crossing_sine = union
    index = np.full((len(keep), len(lines.ends_px)), -1)
    interval = np.zeros((len(keep), len(lines.ends_px), 2))
    index[:, views], interval[:, views] = segments[keep], of_views
    log_density += polarity_evidence(np.asarray(lines.polarity), index, interval, tuning.evidence)
    sides = side_evidence(np.asarray(lines.sides), index, interval, tuning.sides)
    judged_by = ends_mm, np.zeros(len(keep)), log_density, end_log
    found = Candidates(index, interval, *judged_by, outer_mm, spread, px_per_mm, sides)
    return PossiblePairs(found, expected, crossing_sine)


@partial(kept_jit, static_argnames=("tuning", "ends"), beside_others=True)
def _evidence_of(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    pairs: Int[ArrayLike, "h 2"],
    clutter: ClutterModel,
    tuning: CandidateTuning,
    ends: EndTuning,
) -> tuple[Bool[ArrayLike, "h"], Float[ArrayLike, "c h"]]:
    """(whether each can be one line, what is kept of it)."""
    segments = pairs.T
    rows = row_of(planes.first, segments[0]), row_of(planes.second, segments[1])
    of_pencil = pencil_of(planes, lines, views[0], segments[0])
    found = pair_evidence(lines, views, of_pencil, rows, segments, clutter, tuning, ends)
    columns = (
        *(found.interval, found.ends_mm, found.log_density, found.end_log, found.union_ends_mm),
        *(found.union_covariance_mm2, found.px_per_mm, found.expected),
        found.crossing_sine,
    )
    return found.possible, as_columns(columns)
