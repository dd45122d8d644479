"""Segments of a view that lie near the lines that tracks of other views predict."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.projection import project_with_jacobian
from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.every_group import MatchTuning

# numerical: number of tracks that are compared at once with all segments of a view.
ROWS_AT_A_TIME = 256


class PredictedSegments(NamedTuple):
    """Segments of one view that agree with the predicted line of a track; one row for each hit.

    Attributes
    ----------
    track, segment : (h,)
        Indices of the track and of the segment.
    chi_square : (h,)
        Chi-square of their difference, with two degrees of freedom.
    """

    track: Int[np.ndarray, "h"]
    segment: Int[np.ndarray, "h"]
    chi_square: Float[np.ndarray, "h"]


def predict_segments(
    lines: SegmentTable,
    view: int,
    count: int,
    ends_mm: Float[np.ndarray, "t 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
    gate: float,
    tuning: MatchTuning,
) -> PredictedSegments:
    """Find the segments of one view that overlap and agree with the image of a track's line.

    A segment agrees if its chi-square is below `gate`, given the covariances of line and segment.

    Parameters
    ----------
    lines : SegmentTable
        Segments of all views.
    view, count : int
        Index of the view, and its number of segments.
    ends_mm, covariance_mm2 : (t, 2, 3) and (t, 6, 6)
        Lines of the tracks, world frame.
    gate : float
        Upper limit of chi-square.
    tuning : MatchTuning
        Tuned constants.
    """
    ends = np.asarray(lines.ends_px)[view, :count]
    across = np.asarray(lines.across_px2)[view, :count]
    matrix = np.asarray(lines.matrix_px)[view]
    image = project_with_jacobian(matrix, ends_mm)
    hits = [PredictedSegments(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    rows = np.flatnonzero((image.depth > 0).all(axis=1))
    for start in range(0, len(rows), ROWS_AT_A_TIME):
        part = rows[start : start + ROWS_AT_A_TIME]
        uv = image.uv_px[part]
        spread = _across_image(uv, image.by_point[part], covariance_mm2[part])
        # A vague prediction fits any segment.
        is_precise = (
            np.maximum(spread[:, 0, 0], spread[:, 1, 1])
            < tuning.candidates.max_prediction_sigma_px**2
        )
        track, segment, chi_square = _segments_near_images(
            uv[is_precise],
            spread[is_precise],
            ends,
            across,
            gate,
            tuning.candidates.smallest_overlap,
        )
        hits.append(PredictedSegments(part[is_precise][track], segment, chi_square))
    return PredictedSegments(*(np.concatenate(column) for column in zip(*hits, strict=True)))


def _across_image(
    image_px: Float[np.ndarray, "t 2 2"],
    by_point: Float[np.ndarray, "t 2 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
) -> Float[np.ndarray, "t 2 2"]:
    """Return the covariance of both ends of a line's image, perpendicular to it, (t, 2, 2) px^2."""
    step = image_px[:, 1] - image_px[:, 0]
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.linalg.norm(step, axis=1)[:, None]
    by_end = np.einsum("ti,teij->tej", normal, by_point)
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    return np.einsum("tei,teifj,tfj->tef", by_end, blocks, by_end)


def _segments_near_images(
    image_px: Float[np.ndarray, "t 2 2"],
    spread_px2: Float[np.ndarray, "t 2 2"],
    ends_px: Float[np.ndarray, "n 2 2"],
    across_px2: Float[np.ndarray, "n 2 2"],
    gate: float,
    smallest_overlap: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    step = image_px[:, 1] - image_px[:, 0]
    squared = (step**2).sum(axis=1)
    offset = ends_px[None] - image_px[:, None, :1]
    position = (offset @ step[:, None, :, None])[..., 0] / squared[:, None, None]
    begin = np.clip(position.min(axis=2), 0.0, None)
    end = np.clip(position.max(axis=2), None, 1.0)
    extent = position[..., 1] - position[..., 0]
    overlaps = end - begin > smallest_overlap * np.minimum(1.0, np.abs(extent))
    offset_px = (
        offset[..., 1] * step[:, None, None, 0] - offset[..., 0] * step[:, None, None, 1]
    ) / (np.sqrt(squared)[:, None, None])
    # A bound by the largest sigmas removes distant segments before covariances are evaluated.
    widest = spread_px2.max(axis=(1, 2))[:, None] + across_px2.max(axis=(1, 2))
    is_near = np.abs(offset_px).min(axis=2) ** 2 < gate * widest
    is_near |= offset_px[..., 0] * offset_px[..., 1] < 0
    i, j = np.nonzero(overlaps & is_near)
    # Distances at both ends of the common part, with the covariances of line and segment there.
    share = (np.stack([begin, end], axis=2)[i, j] - position[i, j, :1]) / extent[i, j, None]
    weight = np.stack([1 - share, share], axis=2)
    residual = (weight @ offset_px[i, j][:, :, None])[..., 0]
    line_position = np.stack([begin, end], axis=2)[i, j]
    line_weight = np.stack([1 - line_position, line_position], axis=2)
    total = weight @ across_px2[j] @ weight.mT + line_weight @ spread_px2[i] @ line_weight.mT
    chi_square = (residual * np.linalg.solve(total, residual[..., None])[..., 0]).sum(axis=1)
    is_match = chi_square < gate
    return i[is_match], j[is_match], chi_square[is_match]
