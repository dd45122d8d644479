"""Which segments of a view lie where tracks of other views predict them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.projection import project_with_jacobian
from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.every_group import MatchTuning

# numerical: tracks compared at once with all segments of a view.
ROWS = 256


class PredictedSegments(NamedTuple):
    """Segments that pass the gate of a prediction: which track, segment, and chi-square."""

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
    """Segments of a view that overlap the image of a track's line and fit it, under the covariances
    of both: their chi-square, of 2 degrees of freedom, passes the gate."""
    ends = np.asarray(lines.ends_px)[view, :count]
    across = np.asarray(lines.across_px2)[view, :count]
    matrix = np.asarray(lines.matrix_px)[view]
    image = project_with_jacobian(matrix, ends_mm)
    found = [PredictedSegments(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    rows = np.flatnonzero((image.depth > 0).all(axis=1))
    for start in range(0, len(rows), ROWS):
        part = rows[start : start + ROWS]
        uv = image.uv_px[part]
        spread = _across_image(uv, image.by_point[part], covariance_mm2[part])
        # Only known places predict: elsewhere anything fits.
        known = np.maximum(spread[:, 0, 0], spread[:, 1, 1]) < tuning.candidates.vaguest_px**2
        track, segment, chi_square = _fitting(
            uv[known],
            spread[known],
            ends,
            across,
            gate,
            tuning.candidates.smallest_overlap,
        )
        found.append(PredictedSegments(part[known][track], segment, chi_square))
    return PredictedSegments(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _across_image(
    image_px: Float[np.ndarray, "t 2 2"],
    by_point: Float[np.ndarray, "t 2 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
) -> Float[np.ndarray, "t 2 2"]:
    """Covariance of the two ends of the image across it."""
    way = image_px[:, 1] - image_px[:, 0]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.linalg.norm(way, axis=1)[:, None]
    by_end = np.einsum("ti,teij->tej", normal, by_point)
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    return np.einsum("tei,teifj,tfj->tef", by_end, blocks, by_end)


def _fitting(
    image_px: Float[np.ndarray, "t 2 2"],
    spread_px2: Float[np.ndarray, "t 2 2"],
    ends_px: Float[np.ndarray, "n 2 2"],
    across_px2: Float[np.ndarray, "n 2 2"],
    gate: float,
    least_overlap: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    way = image_px[:, 1] - image_px[:, 0]
    squared = (way**2).sum(axis=1)
    offset = ends_px[None] - image_px[:, None, :1]
    place = (offset @ way[:, None, :, None])[..., 0] / squared[:, None, None]
    begin = np.clip(place.min(axis=2), 0.0, None)
    end = np.clip(place.max(axis=2), None, 1.0)
    reach = place[..., 1] - place[..., 0]
    overlaps = end - begin > least_overlap * np.minimum(1.0, np.abs(reach))
    off = (offset[..., 1] * way[:, None, None, 0] - offset[..., 0] * way[:, None, None, 1]) / (
        np.sqrt(squared)[:, None, None]
    )
    # Far away is far away, whatever the covariances: at most a few of the widest sigmas.
    widest = spread_px2.max(axis=(1, 2))[:, None] + across_px2.max(axis=(1, 2))
    near = np.abs(off).min(axis=2) ** 2 < gate * widest
    near |= off[..., 0] * off[..., 1] < 0
    i, j = np.nonzero(overlaps & near)
    # Distances where the common part begins and ends, with the covariances of both there.
    share = (np.stack([begin, end], axis=2)[i, j] - place[i, j, :1]) / reach[i, j, None]
    weight = np.stack([1 - share, share], axis=2)
    residual = (weight @ off[i, j][:, :, None])[..., 0]
    on_line = np.stack([begin, end], axis=2)[i, j]
    line_weight = np.stack([1 - on_line, on_line], axis=2)
    total = weight @ across_px2[j] @ weight.mT + line_weight @ spread_px2[i] @ line_weight.mT
    chi_square = (residual * np.linalg.solve(total, residual[..., None])[..., 0]).sum(axis=1)
    fits = chi_square < gate
    return i[fits], j[fits], chi_square[fits]
