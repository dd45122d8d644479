"""Which circle of the pattern each blob of a lattice is, or why that cannot be told."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detection.pattern_symmetry import PatternSymmetry
from trinoc.calib.detection.placing import placements
from trinoc.calib.targets import Pattern
from trinoc.errors import DetectionError

# A labelling must beat every other by this much: more than one misread circle can give.
_MARGIN = 16.0
# At most this share of the circles may contradict the labelling.
_MOST_WRONG = 0.1


class MirroredError(DetectionError):
    """The sheet is seen mirrored: no other way of looking will change that."""


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
    layout: PatternSymmetry,
) -> Labelling:
    """The one placement of a lattice on the pattern that its rings allow.

    ring_evidence : log of the odds that each circle is a ring.

    Raises
    ------
    DetectionError : the picture is mirrored, it shows another pattern, or too little of the
        sheet is seen to tell where it lies.
    """
    seen = placements(cell, ring_evidence, pattern, layout.turns)
    best = int(np.argmax(seen.score))
    if layout.is_chiral:
        mirrored = placements(cell, ring_evidence, pattern, layout.mirrors)
        if mirrored.score.max() > seen.score[best] + _MARGIN:
            worst = int(np.argmax(mirrored.score))
            if _contradicting(mirrored.index[worst], ring_evidence, pattern) <= _allowed(len(cell)):
                raise MirroredError(
                    f"The picture shows the sheet {pattern.name!r} mirrored; flip it left to"
                    " right, or photograph the printed side."
                )
    wrong = _contradicting(seen.index[best], ring_evidence, pattern)
    if wrong > _allowed(len(cell)):
        raise DetectionError(
            f"The picture shows a grid of {len(cell)} circles, but {wrong} of them do not fit"
            f" the pattern {pattern.name!r}; give the pattern that was printed, or, where "
            "the picture is blurred, focus the camera."
        )
    rivals = np.flatnonzero(seen.score > seen.score[best] - _MARGIN).tolist()
    symmetric = layout.symmetries
    own = np.where(seen.index[best] >= 0, symmetric[:, seen.index[best]], -1)
    foreign = [k for k in rivals if not np.any(np.all(own == seen.index[k], axis=1))]
    if layout.is_chiral and mirrored.score.max() > seen.score[best] - _MARGIN:
        foreign.append(-1)
    if foreign:
        raise DetectionError(
            f"Only {len(cell)} circles of the pattern {pattern.name!r} are seen, which fit it in"
            " more than one place; show more of the sheet."
        )
    return Labelling(own, symmetric)


def _contradicting(
    index: Int[np.ndarray, "m"], ring_evidence: Float[np.ndarray, "m"], pattern: Pattern
) -> int:
    """Circles outside the pattern, or clearly a ring where it has a disc or the reverse."""
    is_ring = np.append(pattern.is_ring, False)[index]
    misread = np.where(is_ring, ring_evidence < -4.0, ring_evidence > 4.0)
    return int(np.sum((index < 0) | misread))


def _allowed(circles: int) -> int:
    return int(_MOST_WRONG * circles)
