"""Which circle of the pattern each blob of a lattice is, or why that cannot be said.

A lattice is laid on the pattern in every turn and at every shift; its rings say which is right.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.errors import DetectionError, InputError

# numerical: the corners of one cell of a lattice.
_FEWEST_CIRCLES = 4


class MirroredError(DetectionError):
    """The sheet is seen mirrored: no other search will change that."""


class PatternSymmetry(NamedTuple):
    """A pattern, its lattice, and the symmetries of the lattice.

    steps_mm : (2, 2) columns are the steps on the sheet of one lattice unit.
    radius_mm : the common radius of the circles (their median).
    hole_ratio : inner over outer radius of the rings; 0 without rings.
    turns : (k, 2, 2) integer maps of the lattice that rotate the sheet rigidly.
    mirrors : (k, 2, 2) those that turn it over.
    symmetries : (s, n) permutations of the circles by turns that leave the sheet as it is, the
        identity first.
    is_chiral : whether the sheet differs from its mirror image.
    """

    pattern: Pattern
    steps_mm: Float[np.ndarray, "2 2"]
    radius_mm: float
    hole_ratio: float
    turns: Int[np.ndarray, "turns 2 2"]
    mirrors: Int[np.ndarray, "mirrors 2 2"]
    symmetries: Int[np.ndarray, "s n"]
    is_chiral: bool

    @property
    def pitch_radii(self) -> float:
        """Mean pitch in radii of the circles."""
        return float(np.sqrt(abs(np.linalg.det(self.steps_mm)))) / self.radius_mm


def pattern_symmetry(pattern: Pattern, tuning: CalibTuning) -> PatternSymmetry:
    """The lattice of a pattern.

    Raises
    ------
    InputError : its circles do not span a plane lattice, so no picture can be labelled.
    """
    relative = pattern.lattice - pattern.lattice.mean(axis=0)
    steps, _, rank, _ = np.linalg.lstsq(relative, pattern.centres_mm, rcond=None)
    if len(pattern) < _FEWEST_CIRCLES or rank < 2:
        raise InputError(
            f"The pattern {pattern.name!r} has too few circles off one line to be found in a"
            f" picture; use at least a 2 x 2 grid."
        )
    quarter = np.array([[0, -1], [1, 0]])
    quarters = np.stack([np.linalg.matrix_power(quarter, k) for k in range(4)])
    turns = _rigid_maps(quarters, steps.T)
    mirrors = _rigid_maps(quarters @ np.array([[-1, 0], [0, 1]]), steps.T)
    rings = pattern.is_ring
    ratio = pattern.inner_radius_mm[rings] / pattern.radius_mm[rings]
    return PatternSymmetry(
        pattern=pattern,
        steps_mm=steps.T,
        radius_mm=float(np.median(pattern.radius_mm)),
        hole_ratio=float(np.median(ratio)) if np.any(rings) else 0.0,
        turns=turns,
        mirrors=mirrors,
        symmetries=_symmetries(pattern, turns, tuning),
        is_chiral=len(_symmetries(pattern, mirrors, tuning)) == 0,
    )


def _rigid_maps(
    maps: Int[np.ndarray, "k 2 2"], steps_mm: Float[np.ndarray, "2 2"]
) -> Int[np.ndarray, "rigid 2 2"]:
    """The maps of the lattice that are rotations or reflections of the sheet itself."""
    on_sheet = steps_mm @ maps @ np.linalg.inv(steps_mm)
    gram = np.swapaxes(on_sheet, 1, 2) @ on_sheet
    return maps[np.all(np.abs(gram - np.eye(2)) < 0.1, axis=(1, 2))]


def _symmetries(
    pattern: Pattern, maps: Int[np.ndarray, "turns 2 2"], tuning: CalibTuning
) -> Int[np.ndarray, "k n"]:
    """Permutations of the circles by those maps of the lattice that leave the sheet as it is.

    The identity, if `maps` holds it, comes first.
    """
    ring_evidence = np.where(pattern.is_ring, 2.0, -2.0)
    index, score = _placements(pattern.lattice, ring_evidence, pattern, maps, tuning)
    same = index[score > len(pattern) - 0.5]
    is_identity = np.all(same == np.arange(len(pattern)), axis=1)
    return same[np.argsort(~is_identity, kind="stable")]


def _placements(
    cell: Int[np.ndarray, "m 2"],
    ring_evidence: Float[np.ndarray, "m"],
    pattern: Pattern,
    maps: Int[np.ndarray, "turns 2 2"],
    tuning: CalibTuning,
) -> tuple[Int[np.ndarray, "k m"], Float[np.ndarray, "k"]]:
    """Every turn and shift of the lattice on the pattern: (pattern index of each circle, -1 where
    the pattern has none; log likelihood)."""
    low, high = pattern.lattice.min(axis=0), pattern.lattice.max(axis=0)
    grid = np.full(high - low + 1, -1)
    grid[tuple((pattern.lattice - low).T)] = np.arange(len(pattern))
    indices = []
    for lattice_map in maps:
        turned = cell @ lattice_map.T
        # The lattice's box over the pattern's, or the other way, give or take 1.
        to_low, to_high = low - turned.min(axis=0), high - turned.max(axis=0)
        first, last = np.minimum(to_low, to_high) - 1, np.maximum(to_low, to_high) + 1
        shifts = first + np.indices(last - first + 1).reshape(2, -1).T
        at = turned[None] + shifts[:, None] - low
        inside = np.all((at >= 0) & (at < grid.shape), axis=2)
        at = np.where(inside[:, :, None], at, 0)
        indices.append(np.where(inside, grid[at[..., 0], at[..., 1]], -1))
    index = np.concatenate(indices)
    sign = np.append(np.where(pattern.is_ring, 0.5, -0.5), 0.0)
    score = np.where(index >= 0, sign[index] * ring_evidence, -tuning.detection.outside_cost).sum(
        axis=1
    )
    return index, score


def label_circles(
    cell: Int[np.ndarray, "m 2"],
    ring_evidence: Float[np.ndarray, "m"],
    symmetry: PatternSymmetry,
    tuning: CalibTuning,
) -> Int[np.ndarray, "m"]:
    """Pattern index of each circle of a lattice, -1 where the pattern has none.

    It is the one placement that the rings allow, but for the pattern's own symmetries.

    ring_evidence : log of the odds that each circle is a ring.

    Raises
    ------
    DetectionError : the picture is mirrored, it shows another pattern, or too little of the
        sheet is seen to tell where it lies.
    """
    pattern, margin = symmetry.pattern, tuning.detection.margin
    ways, score = _placements(cell, ring_evidence, pattern, symmetry.turns, tuning)
    index, allowed = ways[np.argmax(score)], int(tuning.detection.most_wrong * len(cell))
    rivals = ways[score > score.max() - margin]
    own = np.where(index >= 0, symmetry.symmetries[:, index], -1)
    is_ambiguous = not np.all(np.any(np.all(own == rivals[:, None], axis=2), axis=1))
    if symmetry.is_chiral:
        mirrored, mirrored_score = _placements(
            cell, ring_evidence, pattern, symmetry.mirrors, tuning
        )
        lead = mirrored_score.max() - score.max()
        is_ambiguous |= bool(lead > -margin)
        wrong = _count_contradicting(
            mirrored[mirrored_score.argmax()], ring_evidence, pattern, tuning
        )
        if lead > margin and wrong <= allowed:
            raise MirroredError(
                f"The picture shows the sheet {pattern.name!r} mirrored; flip it left to"
                " right, or photograph the printed side."
            )
    wrong = _count_contradicting(index, ring_evidence, pattern, tuning)
    if wrong > allowed:
        raise DetectionError(
            f"The picture shows a grid of {len(cell)} circles, but {wrong} of them do not fit"
            f" the pattern {pattern.name!r}; give the pattern that was printed, or, where "
            "the picture is blurred, focus the camera."
        )
    if is_ambiguous:
        raise DetectionError(
            f"Only {len(cell)} circles of the pattern {pattern.name!r} are seen, which fit it in"
            " more than one place; show more of the sheet."
        )
    return index


def _count_contradicting(
    index: Int[np.ndarray, "m"],
    ring_evidence: Float[np.ndarray, "m"],
    pattern: Pattern,
    tuning: CalibTuning,
) -> int:
    """Circles outside the pattern, or clearly a ring where it has a disc or the reverse."""
    is_ring = np.append(pattern.is_ring, False)[index]
    clear = tuning.detection.clear_log_odds
    misread = np.where(is_ring, ring_evidence < -clear, ring_evidence > clear)
    return int(np.sum((index < 0) | misread))
