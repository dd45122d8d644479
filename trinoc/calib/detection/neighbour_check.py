"""Corners of a board that do not lie where their neighbours on the board put them.

The image of a small part of a board is smooth: a polynomial of second degree in the board's
coordinates, fitted to a dozen neighbours of a corner, predicts the corner to a small part of the
distance between corners, whatever the lens. A search that mistakes another thing for a corner
misses by far more.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.numerics.joins import point_tree

# numerical: neighbours that predict a corner, and the fewest for a polynomial of second degree.
_NEIGHBOURS, _FEWEST_FOR_CURVATURE, _FEWEST = 12, 9, 5


class NeighbourPrediction(NamedTuple):
    """Pixels at which the neighbours of n corners put them.

    Fields
    ------
    px : (n, 2) predicted position.
    spacing_px : (n,) distance to the nearest neighbour on the board, as the image shows it.
    gain : (n,) standard deviation of predicted less observed, for neighbours and corner of
        standard deviation 1; larger at the edge of the board.
    """

    px: Float[np.ndarray, "n 2"]
    spacing_px: Float[np.ndarray, "n"]
    gain: Float[np.ndarray, "n"]


def predict_from_neighbours(
    board_mm: Float[np.ndarray, "n 2"], corners_px: Float[np.ndarray, "n 2"]
) -> NeighbourPrediction:
    """Predict each corner of at least 6 from those around it, without itself."""
    count = min(_NEIGHBOURS, len(board_mm) - 1)
    distance, near = point_tree(board_mm).query(board_mm, count + 1)
    distance, near = np.asarray(distance)[:, 1:], np.asarray(near)[:, 1:]
    unit = distance[:, :1]
    x, y = np.moveaxis((board_mm[near] - board_mm[:, None]) / unit[..., None], 2, 0)
    terms = [np.ones_like(x), x, y]
    if count >= _FEWEST_FOR_CURVATURE:
        terms += [x * x, x * y, y * y]
    basis = np.stack(terms, axis=2)
    # Terms of third degree that are left out grow with the distance.
    root = 1.0 / (1.0 + (distance / unit) ** 2)
    # Neighbours in one row leave curvature across it open: the smallest solution has none.
    weights = np.linalg.pinv(basis * root[..., None], rcond=1e-6)[:, 0] * root
    weights = weights[:, None, :]
    predicted = (weights @ corners_px[near])[:, 0]
    # Of the four nearest, each by its own distance: one of them may lie anywhere.
    away_px = np.linalg.norm(corners_px[near[:, :4]] - predicted[:, None], axis=2)
    spacing = np.median(away_px * (unit / distance[:, :4]), axis=1)
    return NeighbourPrediction(
        predicted, spacing, np.sqrt(1.0 + np.sum(weights[:, 0] ** 2, axis=1))
    )


def are_in_place(
    board_mm: Float[np.ndarray, "n 2"],
    corners_px: Float[np.ndarray, "n 2"],
    largest_share: float,
    tuning: CalibTuning,
) -> Bool[np.ndarray, "n"]:
    """Which of n corners lie where the others put them. Fewer than 7 corners are not tested.

    The worst one is removed until the rest agree, because it spoils the prediction of its
    neighbours.

    Parameters
    ----------
    board_mm, corners_px : (n, 2) on the board, and in the image.
    largest_share : miss that is allowed, as a share of the distance to the next corner.
    """
    kept = np.ones(len(board_mm), dtype=bool)
    while kept.sum() > _FEWEST + 1:
        rows = np.flatnonzero(kept)
        predicted = predict_from_neighbours(board_mm[rows], corners_px[rows])
        miss_px = np.linalg.norm(predicted.px - corners_px[rows], axis=1)
        typical = float(np.median(miss_px / predicted.gain))
        allowed = np.maximum(
            largest_share * predicted.spacing_px,
            tuning.detection.out_of_place_medians * typical,
        )
        is_off = miss_px > predicted.gain * allowed
        if not is_off.any():
            break
        # At the edge of the board a neighbour may be spoilt by most of the error of a wrong corner.
        kept[rows[np.argmax(is_off * miss_px / predicted.spacing_px)]] = False
    return kept
