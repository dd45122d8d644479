"""Labelling of a sheet: the pattern index of each circle of a lattice.

The lattice is placed on the pattern in all rotations and shifts. The rings determine which
placement is right.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.errors import DetectionError, InputError

# numerical: number of corners of one cell of a lattice.
_FEWEST_CIRCLES = 4


class MirroredError(DetectionError):
    """Error that the image is mirrored. No other search can succeed, so the detection ends."""


class PatternSymmetry(NamedTuple):
    """A pattern with the steps of its lattice and its symmetries.

    Attributes
    ----------
    pattern : the sheet.
    steps_mm : (2, 2) displacements on the sheet by one lattice unit along each axis, as columns.
    radius_mm : median radius of the circles.
    hole_ratio : inner radius of the rings divided by the outer radius; 0 for a sheet without rings.
    turns : (k, 2, 2) integer matrices that map the lattice to itself and rotate the sheet.
    mirrors : (k, 2, 2) integer matrices that map the lattice to itself and reflect the sheet.
    symmetries : (s, n) permutations of the circles by rotations that map the sheet onto itself; the
        identity is first.
    is_chiral : True if the sheet differs from its mirror image.
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
        """Mean distance of neighbouring circle centres divided by the radius of the circles."""
        return float(np.sqrt(abs(np.linalg.det(self.steps_mm)))) / self.radius_mm


def pattern_symmetry(pattern: Pattern, tuning: CalibTuning) -> PatternSymmetry:
    """Compute the lattice steps and the symmetries of a pattern.

    Parameters
    ----------
    pattern : the sheet.
    tuning : tuned constants of calibration.

    Raises
    ------
    InputError : the circles do not span a plane lattice, so that no image can be labelled.
    """
    relative = pattern.lattice - pattern.lattice.mean(axis=0)
    steps, _, rank, _ = np.linalg.lstsq(relative, pattern.centres_mm, rcond=None)
    if len(pattern) < _FEWEST_CIRCLES or rank < 2:
        raise InputError(
            f"The pattern {pattern.name!r} has too few circles, or all on one line, and cannot be"
            f" detected; use at least a 2 x 2 grid."
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
    """Select the integer matrices that rotate or reflect the sheet without distortion.

    maps : (k, 2, 2) matrices that act on lattice coordinates.
    """
    on_sheet = steps_mm @ maps @ np.linalg.inv(steps_mm)
    gram = np.swapaxes(on_sheet, 1, 2) @ on_sheet
    return maps[np.all(np.abs(gram - np.eye(2)) < 0.1, axis=(1, 2))]


def _symmetries(
    pattern: Pattern, maps: Int[np.ndarray, "turns 2 2"], tuning: CalibTuning
) -> Int[np.ndarray, "k n"]:
    """Permutations of the circles by the lattice maps that map the sheet onto itself.

    The identity is first, if `maps` contains it.
    """
    ring_evidence = np.where(pattern.is_ring, 2.0, -2.0)
    index, score = _placements(pattern.lattice, ring_evidence, pattern, maps, tuning)
    symmetries = index[score > len(pattern) - 0.5]
    is_identity = np.all(symmetries == np.arange(len(pattern)), axis=1)
    return symmetries[np.argsort(~is_identity, kind="stable")]


def _placements(
    cell: Int[np.ndarray, "m 2"],
    ring_evidence: Float[np.ndarray, "m"],
    pattern: Pattern,
    maps: Int[np.ndarray, "turns 2 2"],
    tuning: CalibTuning,
) -> tuple[Int[np.ndarray, "k m"], Float[np.ndarray, "k"]]:
    """All placements of the detected circles on the pattern, by all lattice maps and shifts.

    Parameters
    ----------
    cell : (m, 2) lattice coordinates of the detected circles.
    ring_evidence : (m,) log odds that each circle is a ring.
    maps : (turns, 2, 2) integer matrices that act on lattice coordinates.

    Returns
    -------
    (k, m) pattern index of each circle, -1 for a circle outside the pattern; (k,) log likelihood of
    each placement.
    """
    low, high = pattern.lattice.min(axis=0), pattern.lattice.max(axis=0)
    grid = np.full(high - low + 1, -1)
    grid[tuple((pattern.lattice - low).T)] = np.arange(len(pattern))
    indices = []
    for lattice_map in maps:
        turned = cell @ lattice_map.T
        # Shifts at which one bounding box lies within the other, or one step beyond.
        to_low, to_high = low - turned.min(axis=0), high - turned.max(axis=0)
        first, last = np.minimum(to_low, to_high) - 1, np.maximum(to_low, to_high) + 1
        shifts = first + np.indices(last - first + 1).reshape(2, -1).T
        node = turned[None] + shifts[:, None] - low
        inside = np.all((node >= 0) & (node < grid.shape), axis=2)
        node = np.where(inside[:, :, None], node, 0)
        indices.append(np.where(inside, grid[node[..., 0], node[..., 1]], -1))
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
    """Find the pattern index of each circle of a lattice.

    The labelling fails if several placements of the lattice on the pattern agree with the detected
    rings and discs. Placements that differ by a symmetry of the pattern count as one.

    Parameters
    ----------
    cell : (m, 2) lattice coordinates of the detected circles.
    ring_evidence : (m,) log odds that each circle is a ring.
    symmetry : the pattern with its symmetries.
    tuning : tuned constants of calibration.

    Returns
    -------
    (m,) pattern indices of one of the equivalent placements, -1 for a circle outside the pattern.

    Raises
    ------
    DetectionError : the image is mirrored, shows another pattern, or shows too little of the sheet.
    """
    pattern, margin = symmetry.pattern, tuning.detection.margin
    placements, score = _placements(cell, ring_evidence, pattern, symmetry.turns, tuning)
    index, allowed = placements[np.argmax(score)], int(tuning.detection.most_wrong * len(cell))
    rivals = placements[score > score.max() - margin]
    equivalent = np.where(index >= 0, symmetry.symmetries[:, index], -1)
    is_ambiguous = not np.all(np.any(np.all(equivalent == rivals[:, None], axis=2), axis=1))
    if symmetry.is_chiral:
        mirrored, mirrored_score = _placements(
            cell, ring_evidence, pattern, symmetry.mirrors, tuning
        )
        lead = mirrored_score.max() - score.max()
        is_ambiguous |= bool(lead > -margin)
        contradicting = _count_contradicting(
            mirrored[mirrored_score.argmax()], ring_evidence, pattern, tuning
        )
        if lead > margin and contradicting <= allowed:
            raise MirroredError(
                f"The image shows the sheet {pattern.name!r} mirrored; flip the image left to"
                " right, or photograph the printed side."
            )
    contradicting = _count_contradicting(index, ring_evidence, pattern, tuning)
    if contradicting > allowed:
        raise DetectionError(
            f"The image shows a grid of {len(cell)} circles, but {contradicting} of them do not fit"
            f" the pattern {pattern.name!r}; give the pattern that was printed, or focus the"
            " camera if the image is blurred."
        )
    if is_ambiguous:
        raise DetectionError(
            f"Only {len(cell)} circles of the pattern {pattern.name!r} are visible, and they fit "
            "the pattern at more than one position; show more of the sheet."
        )
    return index


def _count_contradicting(
    index: Int[np.ndarray, "m"],
    ring_evidence: Float[np.ndarray, "m"],
    pattern: Pattern,
    tuning: CalibTuning,
) -> int:
    """Number of circles that contradict a placement.

    These are circles outside the pattern, rings at the position of a disc, and discs at the
    position of a ring.
    """
    is_ring = np.append(pattern.is_ring, False)[index]
    clear = tuning.detection.clear_log_odds
    misread = np.where(is_ring, ring_evidence < -clear, ring_evidence > clear)
    return int(np.sum((index < 0) | misread))
