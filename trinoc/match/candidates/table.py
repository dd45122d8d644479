"""Candidates: groups of segments that can be one line, with the evidence for each."""

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
    """Triples, or pairs, that can be one line; rows of each array belong together.

    index : segment in each of the views (-1 in views that take no part).
    interval : common part on each segment. ends_mm : ends in space.
    chi_square, log_density, union_ends_mm, union_covariance_mm2, px_per_mm : see TripleEvidence.
    end_log : see `end_evidence`. side_log : see `side_evidence`.
    expected : in how many views a pair is not seen that should show it. crossing_sine : of a pair,
        of the angle between its interpretation planes. Both are 0 for triples.
    frame : of a stack, the frame of each.
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
    expected: Float[np.ndarray, "m"]
    crossing_sine: Float[np.ndarray, "m"]
    frame: Int[np.ndarray, "m"] | None = None

    def take(self, rows: np.ndarray) -> "Candidates":
        """Those at the given indices, in that order, or where the mask is true."""
        return take_rows(self, rows)


def build_candidates(
    lines: SegmentTable,
    views: Int[np.ndarray, "k"],
    segments: Int[np.ndarray, "m k"],
    place: Iterable[np.ndarray],
    tuning: MatchTuning,
) -> Candidates:
    """Groups of segments in some views, by the evidence of their `place`: the fields from interval,
    of these views alone, to px_per_mm, and then those of pairs."""
    of_views, ends_mm, chi_square, log_density, end_log, outer_mm, spread, px_per_mm, *more = place
    index = np.full((len(segments), len(lines.ends_px)), -1)
    interval = np.zeros((*index.shape, 2))
    index[:, views], interval[:, views] = segments, of_views
    polarity = polarity_evidence(np.asarray(lines.polarity), index, interval, tuning.evidence)
    evidence = ends_mm, chi_square, log_density + polarity, end_log
    sides = side_evidence(np.asarray(lines.sides), index, interval, tuning.sides)
    expected, sine = more or np.zeros((2, len(index)))
    of_line = outer_mm, spread, px_per_mm, sides, expected, sine
    return Candidates(index, interval, *evidence, *of_line, look_up_frames(lines, index))


def no_candidates(views: int, stacked: bool = False) -> Candidates:
    """None at all, for as many views, of one frame or of a stack."""
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
        np.zeros(0, dtype=np.int32) if stacked else None,
    )


def prior_log_odds(
    candidates: Candidates,
    mixture: MixtureParameters,
    tuning: EvidenceTuning = DEFAULT.evidence,
) -> Float[np.ndarray, "m"]:
    """Log odds of each on its own evidence, under the parameters of its own frame of a stack."""
    c = candidates
    return log_odds(
        c.chi_square, c.log_density, c.end_log, c.ends_mm, c.side_log, mixture, tuning, c.frame
    )


def in_depth_range(
    candidates: Candidates, lines: SegmentTable, depth_range_mm: tuple[float, float] | None
) -> Bool[np.ndarray, "m"]:
    """Whether the ends lie within a range of depths before every camera that sees them; without
    a range, anywhere before them."""
    matrix = take_matrices(lines, candidates.frame)
    depth = matrix[..., 2, :3] @ candidates.ends_mm.mT + matrix[..., 2, 3:]
    near, far = (0.0, np.inf) if depth_range_mm is None else depth_range_mm
    inside = ((depth > near) & (depth < far)).all(axis=2) | (candidates.index < 0)
    return np.asarray(inside.all(axis=1))
