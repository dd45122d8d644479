"""Table of candidates: groups of segments that can be one line, with the evidence for each."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.evidence.endpoints import END_COMPONENTS
from trinoc.match.evidence.mixture import MixtureParameters, log_odds
from trinoc.match.evidence.side_intensity import SIDE_COMPONENTS, polarity_evidence, side_evidence
from trinoc.match.observations.table import SegmentTable, look_up_frames, take_matrices
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.evidence import EvidenceTuning
from trinoc.numerics.tables import take_rows


class Candidates(NamedTuple):
    """Table of candidates: triples or pairs of segments that can be images of one line.

    Attributes
    ----------
    index : (m, v)
        Segment of each view; -1 for views that are not part of the candidate.
    interval : (m, v, 2)
        Common part on each segment (the part of the line that all segments of the candidate show):
        positions from 0 at its first end to 1 at its second.
    ends_mm : (m, 2, 3)
        Ends of the common part in space, world frame.
    chi_square, log_density, union_ends_mm, union_covariance_mm2, px_per_mm : (m, ...)
        As in TripleEvidence.
    end_log : (m, 2, c)
        Result of `end_evidence` for both ends.
    side_log : (m, s)
        Result of `side_evidence`.
    expected_views : (m,)
        Number of other views whose image contains the line of a pair; 0 for triples.
    crossing_sine : (m,)
        Sine of the angle between the interpretation planes of a pair; 0 for triples.
    frame : (m,)
        Frame of each candidate in a stack of frames; None for a single frame.
    """

    index: Int[np.ndarray, "m v"]
    interval: Float[np.ndarray, "m v 2"]
    ends_mm: Float[np.ndarray, "m 2 3"]
    chi_square: Float[np.ndarray, "m"]
    log_density: Float[np.ndarray, "m"]
    end_log: Float[np.ndarray, "m 2 c"]
    union_ends_mm: Float[np.ndarray, "m 2 3"]
    union_covariance_mm2: Float[np.ndarray, "m 2 6"]
    px_per_mm: Float[np.ndarray, "m"]
    side_log: Float[np.ndarray, "m s"]
    expected_views: Float[np.ndarray, "m"]
    crossing_sine: Float[np.ndarray, "m"]
    frame: Int[np.ndarray, "m"] | None = None

    def take(self, rows: np.ndarray) -> "Candidates":
        """Return the candidates with the given indices, or those for which a mask is true."""
        return take_rows(self, rows)


def build_candidates(
    lines: SegmentTable,
    views: Int[np.ndarray, "k"],
    segments: Int[np.ndarray, "m k"],
    evidence_columns: Iterable[np.ndarray],
    tuning: MatchTuning,
) -> Candidates:
    """Build the table of candidates from the columns that the compiled programs return.

    Parameters
    ----------
    lines : SegmentTable
        Segments of all views.
    views : (k,)
        The views that the candidates have segments in.
    segments : (m, k)
        Segment of each candidate in each of these views.
    evidence_columns : iterable of arrays
        The columns interval, ends_mm, chi_square, log_density, end_log, union_ends_mm,
        union_covariance_mm2 and px_per_mm. For pairs, expected_views and crossing_sine follow.
    tuning : MatchTuning
        Tuned constants.
    """
    (
        view_interval,
        ends_mm,
        chi_square,
        log_density,
        end_log,
        outer_mm,
        spread,
        px_per_mm,
        *pair_columns,
    ) = evidence_columns
    index = np.full((len(segments), len(lines.ends_px)), -1)
    interval = np.zeros((*index.shape, 2))
    index[:, views], interval[:, views] = segments, view_interval
    polarity = polarity_evidence(np.asarray(lines.polarity), index, interval, tuning.evidence)
    log_columns = ends_mm, chi_square, log_density + polarity, end_log
    sides = side_evidence(np.asarray(lines.sides), index, interval, tuning.sides)
    expected_views, sine = pair_columns or np.zeros((2, len(index)))
    line_columns = outer_mm, spread, px_per_mm, sides, expected_views, sine
    return Candidates(index, interval, *log_columns, *line_columns, look_up_frames(lines, index))


def no_candidates(views: int, is_stack: bool = False) -> Candidates:
    """Return an empty table of candidates for the given number of views.

    With `is_stack`, the table has the column `frame`, as for a stack of frames.
    """
    return Candidates(
        np.zeros((0, views), dtype=np.int64),
        np.zeros((0, views, 2)),
        np.zeros((0, 2, 3)),
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 2, END_COMPONENTS)),
        np.zeros((0, 2, 3)),
        np.zeros((0, 2, 6)),
        np.zeros(0),
        np.zeros((0, len(SIDE_COMPONENTS))),
        np.zeros(0),
        np.zeros(0),
        np.zeros(0, dtype=np.int32) if is_stack else None,
    )


def prior_log_odds(
    candidates: Candidates,
    mixture: MixtureParameters,
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Return the log odds of each candidate from its own evidence, (m,).

    Competing candidates and junctions are not considered. `mixture` has one set of parameters
    for each frame of a stack.
    """
    c = candidates
    return log_odds(
        c.chi_square, c.log_density, c.end_log, c.ends_mm, c.side_log, mixture, tuning, c.frame
    )


def in_depth_range(
    candidates: Candidates, lines: SegmentTable, depth_range_mm: tuple[float, float] | None
) -> Bool[np.ndarray, "m"]:
    """Return the mask (m,) of the candidates with both ends in the depth range of their cameras.

    The depths before every camera with a segment of the candidate must be in the range. Without a
    range, any positive depth is allowed.
    """
    matrix = take_matrices(lines, candidates.frame)
    depth = matrix[..., 2, :3] @ candidates.ends_mm.mT + matrix[..., 2, 3:]
    smallest, largest = (0.0, np.inf) if depth_range_mm is None else depth_range_mm
    is_inside = ((depth > smallest) & (depth < largest)).all(axis=2) | (candidates.index < 0)
    return np.asarray(is_inside.all(axis=1))
