"""Lines in space against the truth of a made scene, by length."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.evaluation.distances import measure_near_lengths
from trinoc.synth.truth import SceneTruth, SegmentTruth, shown_parts_mm, shown_parts_of_segments_mm

SAMPLE_STEP_MM = 0.5


class LengthScore(NamedTuple):
    """Share of the length put out that is right, share of the true length that was found."""

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
    """Precision and recall by length, at a distance.

    Precision: the share of the length of `lines_mm` within `tolerance_mm` of a true edge.
    Recall: the share, within `tolerance_mm` of a line put out, of what could be found: the
    parts of edges that at least `views` pictures show, with grey levels that differ by
    `grey_step` across them where pictures are known; of edges of `kinds`, None being all.
    Both are 0 where there is nothing. Samples are at most half a millimetre apart.
    """
    if isinstance(truth, SegmentTruth):
        shown = shown_parts_of_segments_mm(truth, views=views)
    else:
        shown = shown_parts_mm(truth, views=views, grey_step=grey_step, kinds=kinds)
    lines = np.asarray(lines_mm, dtype=np.float64).reshape(-1, 2, 3)
    put_out = measure_near_lengths(lines, truth.edges_mm, SAMPLE_STEP_MM)
    true = measure_near_lengths(shown, lines, SAMPLE_STEP_MM)
    return LengthScore(
        put_out.share_within(tolerance_mm),
        true.share_within(tolerance_mm),
        float(put_out.length_mm.sum()),
        float(true.length_mm.sum()),
    )
