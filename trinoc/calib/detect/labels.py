"""Which circle of the pattern each blob of a lattice is, or why that cannot be told."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detect.layout import Layout
from trinoc.calib.pattern import Pattern
from trinoc.errors import DetectionError

# Evidence is a log likelihood ratio. One circle where the pattern has none must not
# decide a labelling, two may.
_OUTSIDE_COST = 10.0
# A labelling must beat every other by this much: more than one misread circle can give.
_MARGIN = 16.0
# At most this share of the circles may contradict the labelling.
_MOST_WRONG = 0.1


class Labelling(NamedTuple):
    """Pattern index of each circle of a lattice, -1 where the pattern has none.

    choices : (k, m) all labellings that the pattern's own symmetry leaves open, the first
        being the one taken.
    symmetries : (k, n) the permutations of the pattern's circles that lead to them.
    """

    choices: Int[np.ndarray, "k m"]
    symmetries: Int[np.ndarray, "k n"]

    def permute(self, index: Int[np.ndarray, "j"]) -> Int[np.ndarray, "k j"]:
        """Other labels of the pattern's circles `index`, themselves first."""
        return self.symmetries[:, index]


def label_circles(
    cell: Int[np.ndarray, "m 2"],
    ring_evidence: Float[np.ndarray, "m"],
    pattern: Pattern,
    layout: Layout,
) -> Labelling:
    """The one placement of a lattice on the pattern that its rings allow.

    ring_evidence : log of the odds that each circle is a ring.

    Raises
    ------
    DetectionError : the picture is mirrored, it shows another pattern, or too little of the
        sheet is seen to tell where it lies.
    """
    seen = _placements(cell, ring_evidence, pattern, layout.turns)
    best = int(np.argmax(seen.score))
    is_chiral = _symmetries(pattern, layout.mirrors).shape[0] == 0
    if is_chiral:
        mirrored = _placements(cell, ring_evidence, pattern, layout.mirrors)
        if mirrored.score.max() > seen.score[best] + _MARGIN:
            worst = int(np.argmax(mirrored.score))
            if _contradicting(mirrored.index[worst], ring_evidence, pattern) <= _allowed(len(cell)):
                raise DetectionError(
                    f"The picture shows the sheet {pattern.name!r} mirrored; flip it left to"
                    " right, or photograph the printed side."
                )
    wrong = _contradicting(seen.index[best], ring_evidence, pattern)
    if wrong > _allowed(len(cell)):
        raise DetectionError(
            f"The picture shows a grid of {len(cell)} circles, but {wrong} of them do not fit"
            f" the pattern {pattern.name!r}; give the pattern that was printed."
        )
    rivals = np.flatnonzero(seen.score > seen.score[best] - _MARGIN).tolist()
    symmetric = _identity_first(_symmetries(pattern, layout.turns))
    own = np.where(seen.index[best] >= 0, symmetric[:, seen.index[best]], -1)
    foreign = [k for k in rivals if not np.any(np.all(own == seen.index[k], axis=1))]
    if is_chiral and mirrored.score.max() > seen.score[best] - _MARGIN:
        foreign.append(-1)
    if foreign:
        raise DetectionError(
            f"Only {len(cell)} circles of the pattern {pattern.name!r} are seen, which fit it in"
            " more than one place; show more of the sheet."
        )
    return Labelling(own, symmetric)


class _Placements(NamedTuple):
    index: Int[np.ndarray, "k m"]
    score: Float[np.ndarray, "k"]


def _placements(
    cell: Int[np.ndarray, "m 2"],
    ring_evidence: Float[np.ndarray, "m"],
    pattern: Pattern,
    maps: Int[np.ndarray, "turns 2 2"],
) -> _Placements:
    """Every turn and shift of the lattice on the pattern, with its score."""
    grid, low = _index_grid(pattern)
    sign = np.append(np.where(pattern.is_ring, 0.5, -0.5), 0.0)
    indices = []
    for lattice_map in maps:
        turned = cell @ lattice_map.T
        shifts = _shifts(turned, low, np.array(grid.shape))
        at = turned[None] + shifts[:, None] - low
        inside = np.all((at >= 0) & (at < grid.shape), axis=2)
        at = np.where(inside[:, :, None], at, 0)
        indices.append(np.where(inside, grid[at[..., 0], at[..., 1]], -1))
    index = np.concatenate(indices)
    score = (
        sign[index] @ ring_evidence
        if not np.any(index < 0)
        else np.sum(np.where(index >= 0, sign[index] * ring_evidence, -_OUTSIDE_COST), axis=1)
    )
    return _Placements(index, score)


def _index_grid(pattern: Pattern) -> tuple[Int[np.ndarray, "w h"], Int[np.ndarray, "2"]]:
    low, high = pattern.lattice.min(axis=0), pattern.lattice.max(axis=0)
    grid = np.full(high - low + 1, -1)
    grid[tuple((pattern.lattice - low).T)] = np.arange(len(pattern))
    return grid, low


def _shifts(
    turned: Int[np.ndarray, "m 2"], low: Int[np.ndarray, "2"], extent: Int[np.ndarray, "2"]
) -> Int[np.ndarray, "k 2"]:
    """Shifts that lay the lattice's box over the pattern's, or the other way, give or take 1."""
    to_low = low - turned.min(axis=0)
    to_high = low + extent - 1 - turned.max(axis=0)
    first, last = np.minimum(to_low, to_high) - 1, np.maximum(to_low, to_high) + 1
    right, up = (np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
    return np.stack(np.meshgrid(right, up, indexing="ij"), axis=-1).reshape(-1, 2)


def _symmetries(pattern: Pattern, maps: Int[np.ndarray, "turns 2 2"]) -> Int[np.ndarray, "k n"]:
    """Permutations of the circles by those rigid maps that leave the sheet as it is."""
    ring_evidence = np.where(pattern.is_ring, 2.0, -2.0)
    placed = _placements(pattern.lattice, ring_evidence, pattern, maps)
    return placed.index[placed.score > len(pattern) - 0.5]


def _identity_first(symmetric: Int[np.ndarray, "k n"]) -> Int[np.ndarray, "k n"]:
    is_identity = np.all(symmetric == np.arange(symmetric.shape[1]), axis=1)
    return symmetric[np.argsort(~is_identity, kind="stable")]


def _contradicting(
    index: Int[np.ndarray, "m"], ring_evidence: Float[np.ndarray, "m"], pattern: Pattern
) -> int:
    """Circles outside the pattern, or clearly a ring where it has a disc or the reverse."""
    is_ring = np.append(pattern.is_ring, False)[index]
    misread = np.where(is_ring, ring_evidence < -4.0, ring_evidence > 4.0)
    return int(np.sum((index < 0) | misread))


def _allowed(circles: int) -> int:
    return int(_MOST_WRONG * circles)
