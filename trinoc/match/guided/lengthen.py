"""A segment made longer by an edge found beyond its end."""

import numpy as np
from jaxtyping import Float

from trinoc.match.guided.views import Answer


def lengthened(
    ends_px: Float[np.ndarray, "2 2"],
    covariance_px2: Float[np.ndarray, "4 4"],
    end: int,
    length: float,
    answer: Answer,
    row: int,
) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "4 4"]]:
    """A segment whose `end` moves out by `length`, by least squares of its line and of the
    edge found beyond it."""
    here, there = ends_px[end], ends_px[1 - end]
    before = float(np.linalg.norm(here - there))
    unit = (here - there) / before
    right = np.array([-unit[1], unit[0]])
    total = before + length

    def rows_at(along: np.ndarray) -> np.ndarray:
        share = along / total
        return np.stack([1 - share, share], axis=1)

    # Offsets from the segment's own line, at its ends and at those of the piece found beyond.
    old = covariance_px2.reshape(2, 2, 2, 2)
    if end == 0:
        old = old[::-1, :, ::-1]
    own = np.einsum("eifj,i,j->ef", old, right, right)
    piece = answer.ends_px[row] - there
    new = answer.covariance_px2[row].reshape(2, 2, 2, 2)
    beyond = np.einsum("eifj,i,j->ef", new, right, right)
    design = np.concatenate([rows_at(np.array([0.0, before])), rows_at(piece @ unit)])
    information = np.zeros((4, 4))
    information[:2, :2], information[2:, 2:] = np.linalg.inv(own), np.linalg.inv(beyond)
    seen = np.concatenate([np.zeros(2), piece @ right])
    spread = np.linalg.inv(design.T @ information @ design)
    offset = spread @ design.T @ information @ seen
    places = np.stack([there + offset[0] * right, there + total * unit + offset[1] * right])
    along = np.array([unit @ old[0, :, 0] @ unit, unit @ new[1, :, 1] @ unit])
    covariance = np.einsum("ef,i,j->eifj", spread, right, right)
    covariance += np.einsum("ef,e,i,j->eifj", np.eye(2), along, unit, unit)
    if end == 0:
        places, covariance = places[::-1], covariance[::-1, :, ::-1]
    return places, covariance.reshape(4, 4)
