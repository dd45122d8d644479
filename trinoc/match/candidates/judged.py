"""Triples that passed the gate, judged by all of their evidence, in double precision.

Two programs: the first looks the segments up and fits a line to all three; the second computes the
evidence on that line, and serves pictures of any number of segments.
"""

from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.table import Candidates
from trinoc.match.evidence import (
    END_COMPONENTS,
    end_evidence,
    line_of_three,
    polarity_evidence,
    side_evidence,
    triple_evidence,
)
from trinoc.match.observations import TRIPLES_IN_BLOCK, ClutterModel, SegmentTable, block_of
from trinoc.match.tuning import CandidateTuning, EndTuning, MatchTuning
from trinoc.match.two_view import Pencil, Sight, cut_pair, pencil_of, points_of, row_of, sight_of
from trinoc.numerics import (
    ArrayLike,
    Vector3,
    as_columns,
    kept_jit,
    select_in_blocks,
    split_columns,
)

# What is kept of each triple: the shapes of interval, ends_mm, chi_square, log_density, end_log,
# union_ends_mm, union_covariance_mm2, px_per_mm.
_SHAPES = ((3, 2), (2, 3), (), (), (2, END_COMPONENTS), (2, 3), (2, 6), ())


def candidates_of(
    lines: SegmentTable,
    order: Int[np.ndarray, "3"],
    planes: Pencil,
    triple: Int[np.ndarray, "h 3"],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> Candidates:
    """Those triples, segments in the views of an order, that can be one line."""

    def judged(triple: np.ndarray) -> tuple[ArrayLike, ArrayLike]:
        fitted = _fitted(lines, order, planes, triple, clutter, tuning=tuning.candidates)
        return _evidence_of(*fitted, tuning=tuning.candidates, ends=tuning.ends)

    keep, columns = select_in_blocks(judged, block_of(lines, TRIPLES_IN_BLOCK), triple)
    of_order, ends_mm, chi_square, log_density, end_log, *union = split_columns(columns, _SHAPES)
    outer_mm, spread, px_per_mm = union
    index = np.full((len(keep), len(lines.ends_px)), -1)
    interval = np.zeros((len(keep), len(lines.ends_px), 2))
    index[:, order], interval[:, order] = triple[keep], of_order
    log_density += polarity_evidence(np.asarray(lines.polarity), index, interval, tuning.evidence)
    sides = side_evidence(np.asarray(lines.sides), index, interval, tuning.sides)
    judged_by = ends_mm, chi_square, log_density, end_log
    return Candidates(index, interval, *judged_by, outer_mm, spread, px_per_mm, sides)


@partial(kept_jit, static_argnames=("tuning",), beside_others=True)
def _fitted(
    lines: SegmentTable,
    order: Int[ArrayLike, "3"],
    planes: Pencil,
    triple: Int[ArrayLike, "h 3"],
    clutter: ClutterModel,
    tuning: CandidateTuning,
) -> tuple[Sight, tuple[Vector3, Vector3], Bool[ArrayLike, "h"]]:
    """(segments, ends of the line that is fitted to all three, whether it can be one)."""
    segments = triple.T
    sight = sight_of(lines, clutter, order, segments)
    of_pencil = pencil_of(planes, lines, order[0], segments[0])
    rows = row_of(planes.first, segments[0]), row_of(planes.second, segments[1])
    near_mm = points_of(of_pencil, cut_pair(of_pencil.baseline_mm, *rows, tuning))
    return sight, *line_of_three(sight, near_mm, tuning)


@partial(kept_jit, static_argnames=("tuning", "ends"), beside_others=True)
def _evidence_of(
    sight: Sight,
    fitted_mm: tuple[Vector3, Vector3],
    possible: Bool[ArrayLike, "h"],
    tuning: CandidateTuning,
    ends: EndTuning,
) -> tuple[Bool[ArrayLike, "h"], Float[ArrayLike, "c h"]]:
    """(whether each can be one line, what is kept of it), on the line fitted to all three: it does
    not matter which pair came first."""
    found = triple_evidence(sight, fitted_mm, tuning)
    columns = (
        *(found.interval, found.ends_mm, found.chi_square, found.log_density),
        *(end_evidence(found.extent_px, ends), found.union_ends_mm),
        *(found.union_covariance_mm2, found.px_per_mm),
    )
    return possible & found.possible, as_columns(columns)
