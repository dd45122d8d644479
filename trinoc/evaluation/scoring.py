"""Precision and recall by length of 3-D lines, against the truth of a synthetic scene."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.evaluation.distances import measure_near_lengths
from trinoc.synth.truth import SceneTruth, SegmentTruth, shown_parts_mm, shown_parts_of_segments_mm

SAMPLE_STEP_MM = 0.5


class LengthScore(NamedTuple):
    """Precision and recall of 3-D lines, both as shares of length.

    Attributes
    ----------
    precision : float
        Share of the lines' length that lies on a true edge.
    recall : float
        Share of the visible true length that lies on a line.
    length_put_out_mm : float
        Total length of the lines.
    length_true_mm : float
        Total length of the visible parts of the true edges.
    """

    precision: float
    recall: float
    length_put_out_mm: float
    length_true_mm: float


def score_lengths(
    lines_mm: Float[np.ndarray, "t 2 3"],
    truth: SceneTruth | SegmentTruth,
    *,
    tolerance_mm: float = 1.0,
    views: int = 2,
    grey_step: float = 0.0,
    kinds: tuple[str, ...] | None = None,
) -> LengthScore:
    """Compute precision and recall of 3-D lines by length.

    Parameters
    ----------
    lines_mm : (t, 2, 3)
        Ends of the lines.
    truth : SceneTruth or SegmentTruth
        True edges, with the parts that each view shows.
    tolerance_mm : float
        Largest distance at which a point of a line lies on an edge, and the reverse.
    views : int
        Number of views that must show a part of an edge, so that it counts for recall.
    grey_step : float
        Smallest difference of grey levels across such a part. Ignored for a SegmentTruth.
    kinds : tuple of str, optional
        Kinds of edges that count for recall. Default: all. Ignored for a SegmentTruth.

    Returns
    -------
    LengthScore
        Both shares are 0 if there is no length. Samples are at most 0.5 mm apart.
    """
    if isinstance(truth, SegmentTruth):
        visible_parts = shown_parts_of_segments_mm(truth, views=views)
    else:
        visible_parts = shown_parts_mm(truth, views=views, grey_step=grey_step, kinds=kinds)
    lines = np.asarray(lines_mm, dtype=np.float64).reshape(-1, 2, 3)
    line_lengths = measure_near_lengths(lines, truth.edges_mm, SAMPLE_STEP_MM)
    true_lengths = measure_near_lengths(visible_parts, lines, SAMPLE_STEP_MM)
    return LengthScore(
        line_lengths.share_within(tolerance_mm),
        true_lengths.share_within(tolerance_mm),
        float(line_lengths.length_mm.sum()),
        float(true_lengths.length_mm.sum()),
    )
