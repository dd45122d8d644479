"""Test of corners against the prediction of their neighbours on the board.

The image of a small part of a board is smooth. A quadratic polynomial in board coordinates is
fitted to a dozen neighbours of a corner. It predicts the corner to a small part of the corner
distance, for every lens. A false corner has a much larger error.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.numerics.joins import point_tree

# numerical: number of neighbours that predict a corner; fewest for a quadratic; fewest at all.
_NEIGHBOURS, _FEWEST_FOR_CURVATURE, _FEWEST = 12, 9, 5


class NeighbourPrediction(NamedTuple):
    """Positions of n corners, each predicted from its neighbours.

    Attributes
    ----------
    px : (n, 2) predicted positions.
    spacing_px : (n,) distance to the nearest neighbour on the board, as it appears in the image.
    gain : (n,) standard deviation of predicted minus observed position, if all corners have a
        standard deviation of 1. It is larger at the edge of the board.
    """

    px: Float[np.ndarray, "n 2"]
    spacing_px: Float[np.ndarray, "n"]
    gain: Float[np.ndarray, "n"]


def predict_from_neighbours(
    board_mm: Float[np.ndarray, "n 2"], corners_px: Float[np.ndarray, "n 2"]
) -> NeighbourPrediction:
    """Predict the image position of each corner from its neighbours, without the corner itself.

    Parameters
    ----------
    board_mm, corners_px : (n, 2) positions on the board and in the image; n is at least 6.
    """
    count = min(_NEIGHBOURS, len(board_mm) - 1)
    distance, neighbours = point_tree(board_mm).query(board_mm, count + 1)
    distance, neighbours = np.asarray(distance)[:, 1:], np.asarray(neighbours)[:, 1:]
    unit = distance[:, :1]
    x, y = np.moveaxis((board_mm[neighbours] - board_mm[:, None]) / unit[..., None], 2, 0)
    terms = [np.ones_like(x), x, y]
    if count >= _FEWEST_FOR_CURVATURE:
        terms += [x * x, x * y, y * y]
    basis = np.stack(terms, axis=2)
    # The neglected terms of third degree grow with the distance.
    root = 1.0 / (1.0 + (distance / unit) ** 2)
    # Neighbours in one row do not determine the curvature across it: the pseudoinverse makes it 0.
    weights = np.linalg.pinv(basis * root[..., None], rcond=1e-6)[:, 0] * root
    weights = weights[:, None, :]
    predicted = (weights @ corners_px[neighbours])[:, 0]
    # Median over the four nearest, because one of them may be a false corner.
    away_px = np.linalg.norm(corners_px[neighbours[:, :4]] - predicted[:, None], axis=2)
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
    """Mask of the corners that agree with the prediction from their neighbours.

    A false corner disturbs the prediction of its neighbours. Therefore the worst corner is removed
    and the test repeated, until all remaining corners agree. Fewer than 7 corners are not tested.

    Parameters
    ----------
    board_mm, corners_px : (n, 2) positions on the board and in the image.
    largest_share : largest error, as a share of the distance to the nearest corner.
    tuning : tuned constants of calibration.
    """
    in_place = np.ones(len(board_mm), dtype=bool)
    while in_place.sum() > _FEWEST + 1:
        rows = np.flatnonzero(in_place)
        predicted = predict_from_neighbours(board_mm[rows], corners_px[rows])
        error_px = np.linalg.norm(predicted.px - corners_px[rows], axis=1)
        typical = float(np.median(error_px / predicted.gain))
        allowed = np.maximum(
            largest_share * predicted.spacing_px,
            tuning.detection.out_of_place_medians * typical,
        )
        is_off = error_px > predicted.gain * allowed
        if not is_off.any():
            break
        # Without division by the gain: at the edge of the board, a false corner causes an error of
        # nearly its own size at its neighbour.
        in_place[rows[np.argmax(is_off * error_px / predicted.spacing_px)]] = False
    return in_place
