"""The parts of segments that pieces of rims lie abreast of."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.observations import MatchInput, distorted
from trinoc.match.rims.circles import MIDDLE, ON_ARC, Chords, Circles, off_circles
from trinoc.match.tracks import ending_view, fragments_of, interval_of


def fragments_abreast(
    views: tuple[str, ...],
    seen: MatchInput,
    chords: Chords,
    circles: Circles,
    chord: Int[np.ndarray, "p v"],
    lines_mm: Float[np.ndarray, "p 2 3"],
    index: Int[np.ndarray, "p v"],
) -> tuple[Float[np.ndarray, "p v 2 2"], Float[np.ndarray, "p v 4 4"]]:
    """The parts of segments abreast of pieces, and their covariance: how far a segment bows off
    its arc is an error of both ends."""
    column = [views.index(name) for name in seen.names]
    own = np.full(index.shape, -1)
    for view, at in enumerate(column):
        back = np.argsort(seen.order[view])
        own[:, view] = np.where(index[:, at] >= 0, back[np.maximum(index[:, at], 0)], -1)
    here = ending_view(seen, own, lines_mm)
    interval = np.clip(interval_of(seen, own, lines_mm), 0.0, 1.0)
    parts, covariance = fragments_of(seen, own, interval, here)
    fragments, spread = np.full(parts.shape, np.nan), np.full(covariance.shape, np.nan)
    for view, at in enumerate(column):
        on = np.flatnonzero(index[:, at] >= 0)
        way = parts[on, view, 1] - parts[on, view, 0]
        way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        right = np.stack([-way[:, 1], way[:, 0]], axis=1)
        bow = _bows(chords, circles, chord[on, at])
        blocks = covariance[on, view].reshape(-1, 2, 2, 2, 2)
        more = (bow**2)[:, None, None] * right[:, :, None] * right[:, None]
        for end in (0, 1):
            blocks[:, end, :, end] += more
        spread[on, at] = blocks.reshape(-1, 4, 4)
        lens = seen.frames[0].cameras.intrinsics[view]
        fragments[on, at] = distorted(lens, parts[on, view])
    return fragments, spread


def _bows(chords: Chords, circles: Circles, row: Int[np.ndarray, "p"]) -> Float[np.ndarray, "p"]:
    """How far chords are off their arcs between the places where they cross them, px; each chord
    is that of the circle which it is nearest to."""
    if len(row) == 0:
        return np.zeros(0)
    unique, back = np.unique(row, return_inverse=True)
    px = off_circles(Chords(*(part[unique] for part in chords)), circles).px
    nearest = np.abs(px[..., ON_ARC]).max(axis=2).argmin(axis=0)
    px = px[nearest, np.arange(len(unique))]
    return np.abs(px[:, MIDDLE] - px[:, ON_ARC].mean(axis=1))[back]
