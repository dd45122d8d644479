"""Which parts of a rim chords show, and its pieces: cut where the segment of a view ends."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.bodies.circles import ENDS, MIDDLE, Circles
from trinoc.match.tuning import RimTuning
from trinoc.numerics import axes_across

ROUND = 2 * np.pi


class Arcs(NamedTuple):
    """What chords cover of a circle, by angle: from begin to end, begin in [0, 2 pi)."""

    begin: Float[np.ndarray, "n"]
    end: Float[np.ndarray, "n"]

    def hold(self, angle: Float[np.ndarray, "a"]) -> Bool[np.ndarray, "a n"]:
        """Whether each covers each angle."""
        return (angle[:, None] - self.begin) % ROUND < self.end - self.begin


class Pieces(NamedTuple):
    """begin, end : (p,) angles. chord : (p, v) that shows each in each view, -1 for none."""

    begin: Float[np.ndarray, "p"]
    end: Float[np.ndarray, "p"]
    chord: Int[np.ndarray, "p v"]


def arcs_of(around_mm: Float[np.ndarray, "n 5 3"], circle: Circles) -> Arcs:
    """What chords cover of one circle; `around_mm` are its points next to their places."""
    across = axes_across(circle.normal)[0]
    out = (around_mm - circle.centre_mm[0]) @ across.T
    angle = np.arctan2(out[..., 1], out[..., 0])
    middle = angle[:, MIDDLE]
    apart = (angle[:, ENDS] - middle[:, None] + np.pi) % ROUND - np.pi
    begin, end = middle + apart.min(axis=1), middle + apart.max(axis=1)
    turns = np.floor(begin / ROUND) * ROUND
    return Arcs(begin - turns, end - turns)


def covered_by_two(arcs: Arcs, view: Int[np.ndarray, "n"], views: int) -> float:
    """Share of the circle that chords of two views or more show."""
    border = np.unique(np.concatenate([arcs.begin, arcs.end]) % ROUND)
    if len(border) == 0:
        return 0.0
    width = np.diff(border, append=border[0] + ROUND)
    held = arcs.hold(border + width / 2) @ (view[:, None] == np.arange(views))
    return float(width[held.sum(axis=1) >= 2].sum() / ROUND)


def pieces_of(
    arcs: Arcs, view: Int[np.ndarray, "n"], views: int, least_rad: float, tuning: RimTuning
) -> Pieces:
    """The parts that one set of chords shows each, of two views or more; of several chords of a
    view the one that reaches furthest."""
    border = np.unique(np.concatenate([arcs.begin, arcs.end]) % ROUND)
    width = np.diff(border, append=border[0] + ROUND)
    held = arcs.hold(border + width / 2)
    reach = np.where(held, arcs.end - arcs.begin, 0.0)
    chord = np.full((len(border), views), -1)
    for number in range(views):
        own = np.flatnonzero(view == number)
        if len(own):
            best = own[reach[:, own].argmax(axis=1)]
            chord[:, number] = np.where(reach[np.arange(len(border)), best] > 0, best, -1)
    # Neighbours that the same chords show are one, as long as it is not too long.
    begin, end, rows = [], [], []
    for row, (start, step) in enumerate(zip(border, width, strict=True)):
        same = len(rows) > 0 and (chord[rows[-1]] == chord[row]).all()
        if same and start + step - begin[-1] <= tuning.longest_piece_rad:
            end[-1] = start + step
        else:
            begin.append(start)
            end.append(start + step)
            rows.append(row)
    found = Pieces(np.array(begin), np.array(end), chord[rows])
    kept = ((found.chord >= 0).sum(axis=1) >= 2) & (found.end - found.begin > least_rad)
    return Pieces(*(column[kept] for column in found))
