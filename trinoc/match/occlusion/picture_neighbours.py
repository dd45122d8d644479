"""Segments of one picture that may be sides of one bar, or pieces of one curve."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.tuning import MatchTuning

# What a neighbour is: parallel and beside, or going on from an end.
BESIDE, CONTINUES = 0, 1

# Further apart than pictures are wide, so that frames of a stack are no neighbours.
_FRAME_APART_PX = 1e6


class PictureNeighbours(NamedTuple):
    """Directed. way : seen along `first` from its first end to its second, 1 where `second` lies
    on the right, or goes on from the second end; else 0."""

    first: Int[np.ndarray, "e"]
    second: Int[np.ndarray, "e"]
    kind: Int[np.ndarray, "e"]
    way: Int[np.ndarray, "e"]


def picture_neighbours(
    ends_px: Float[np.ndarray, "n 2 2"],
    tuning: MatchTuning,
    frame: Int[np.ndarray, "n"] | None = None,
) -> PictureNeighbours:
    """Both kinds, among the segments of each frame."""
    if frame is not None:
        ends_px = ends_px + np.stack([frame * _FRAME_APART_PX, 0.0 * frame], axis=1)[:, None]
    step = ends_px[:, 1] - ends_px[:, 0]
    length = np.hypot(*step.T)
    unit = step / length[:, None]
    found = _beside(ends_px, unit, length, tuning), _continuing(ends_px, unit, tuning)
    columns = zip(*found, strict=True)
    return PictureNeighbours(*(np.concatenate(column) for column in columns))


def _beside(
    ends_px: Float[np.ndarray, "n 2 2"],
    unit: Float[np.ndarray, "n 2"],
    length: Float[np.ndarray, "n"],
    tuning: MatchTuning,
) -> PictureNeighbours:
    """Nearly parallel, close, on one side along half of the shorter."""
    least, most = tuning.occlusion.beside_px
    # Places on each, so dense that those of two which lie beside each other are near.
    pieces = np.maximum(np.ceil(length / most).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(length)), pieces)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    along = ((place + 0.5) / pieces[owner] * length[owner])[:, None] * unit[owner]
    near = KDTree(ends_px[owner, 0] + along).query_pairs(1.2 * most, output_type="ndarray")
    i, j = owner[near].T
    number = np.unique(np.concatenate([i * len(length) + j, j * len(length) + i]))
    i, j = np.divmod(number, len(length))
    sine = unit[i, 0] * unit[j, 1] - unit[i, 1] * unit[j, 0]
    parallel = (i != j) & (np.abs(sine) < tuning.junctions.smallest_sine)
    i, j = i[parallel], j[parallel]
    apart = ends_px[j] - ends_px[i, :1]
    on = (apart * unit[i, None]).sum(axis=2)
    off = apart[..., 1] * unit[i, None, 0] - apart[..., 0] * unit[i, None, 1]
    shared = np.minimum(on.max(axis=1), length[i]) - np.maximum(on.min(axis=1), 0.0)
    distance = np.abs(off.mean(axis=1))
    close = (distance > least) & (distance < most) & (off[:, 0] * off[:, 1] > 0)
    close &= shared > 0.5 * np.minimum(length[i], length[j])
    i, j, right = i[close], j[close], (off[close, 0] > 0).astype(np.int64)
    return PictureNeighbours(i, j, np.full(len(i), BESIDE), right)


def _continuing(
    ends_px: Float[np.ndarray, "n 2 2"], unit: Float[np.ndarray, "n 2"], tuning: MatchTuning
) -> PictureNeighbours:
    """An end near another's, and nearly the same way on: ends at an angle are junctions."""
    reach = tuning.occlusion.continues_px
    near = KDTree(ends_px.reshape(-1, 2)).query_pairs(reach, output_type="ndarray")
    near = np.concatenate([near, near[:, ::-1]])
    (i, j), (end, other) = near.T // 2, near.T % 2
    onward = (2 * end - 1)[:, None] * unit[i], (1 - 2 * other)[:, None] * unit[j]
    straight = np.sqrt(1 - tuning.junctions.smallest_sine**2)
    same = (i != j) & ((onward[0] * onward[1]).sum(axis=1) > straight)
    return PictureNeighbours(i[same], j[same], np.full(same.sum(), CONTINUES), end[same])
