"""Candidates: groups of segments that can be one line, with the evidence for each."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.evidence import END_COMPONENTS, SIDE_COMPONENTS, MixtureParameters, log_odds
from trinoc.match.observations import SegmentTable, frames_of, matrices_of
from trinoc.match.tuning import DEFAULT, EvidenceTuning
from trinoc.numerics import take_rows


class Candidates(NamedTuple):
    """Triples, or pairs, that can be one line; rows of each array belong together.

    index : segment in each of the views (-1 in views that take no part).
    interval : common part on each segment. ends_mm : ends in space.
    chi_square, log_density, union_ends_mm, union_covariance_mm2, px_per_mm : see TripleEvidence.
    end_log : see `end_evidence`. side_log : see `side_evidence`.
    expected : in how many views a pair is not seen that should show it. crossing_sine : of a pair,
        of the angle between its interpretation planes. Both are 0 for triples.
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

    def take(self, rows: np.ndarray) -> "Candidates":
        """Those at the given indices, in that order, or where the mask is true."""
        return take_rows(self, rows)


def no_candidates(views: int) -> Candidates:
    """None at all, for as many views."""
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
    )


def prior_log_odds(
    candidates: Candidates,
    mixture: MixtureParameters,
    tuning: EvidenceTuning = DEFAULT.evidence,
    frame: Int[np.ndarray, "m"] | None = None,
) -> Float[np.ndarray, "m"]:
    """Log odds of each on its own evidence, under the parameters of its own frame of a stack."""
    c = candidates
    return log_odds(
        c.chi_square, c.log_density, c.end_log, c.ends_mm, c.side_log, mixture, tuning, frame
    )


def in_depth_range(
    candidates: Candidates, lines: SegmentTable, depth_range_mm: tuple[float, float] | None
) -> Bool[np.ndarray, "m"]:
    """Whether the ends lie within a range of depths before every camera that sees them; without
    a range, anywhere before them."""
    matrix = matrices_of(lines, frames_of(lines, candidates.index))
    depth = matrix[..., 2, :3] @ candidates.ends_mm.mT + matrix[..., 2, 3:]
    near, far = (0.0, np.inf) if depth_range_mm is None else depth_range_mm
    inside = ((depth > near) & (depth < far)).all(axis=2) | (candidates.index < 0)
    return np.asarray(inside.all(axis=1))
