"""What the search needs to know of a pattern, worked out once per picture."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detection.placing import symmetries
from trinoc.calib.targets import Pattern
from trinoc.errors import InputError

_FEWEST_CIRCLES = 4


class PatternSymmetry(NamedTuple):
    """The lattice of a pattern and the symmetries of the lattice.

    circles : how many there are.
    steps_mm : (2, 2) columns are the steps on the sheet of one lattice unit.
    radius_mm : the common radius of the circles (their median).
    hole_ratio : inner over outer radius of the rings; 0 without rings.
    turns : (k, 2, 2) integer maps of the lattice that rotate the sheet rigidly.
    mirrors : (k, 2, 2) those that turn it over.
    symmetries : (s, n) permutations of the circles by turns that leave the sheet as it is, the
        identity first.
    is_chiral : whether the sheet differs from its mirror image.
    """

    circles: int
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


def pattern_symmetry(pattern: Pattern) -> PatternSymmetry:
    """The lattice of `pattern`, remembered for the next picture of it.

    Raises
    ------
    InputError : its circles do not span a plane lattice, so no picture can be labelled.
    """
    key = (pattern.name, *(np.asarray(field).tobytes() for field in _fields(pattern)))
    if key not in _remembered:
        if len(_remembered) >= _MOST_REMEMBERED:
            _remembered.clear()
        _remembered[key] = _layout_of(pattern)
    return _remembered[key]


_remembered: dict[tuple, PatternSymmetry] = {}
_MOST_REMEMBERED = 16


def _fields(pattern: Pattern) -> tuple[np.ndarray, ...]:
    return pattern.centres_mm, pattern.radius_mm, pattern.inner_radius_mm, pattern.lattice


def _layout_of(pattern: Pattern) -> PatternSymmetry:
    relative = pattern.lattice - pattern.lattice.mean(axis=0)
    if len(pattern) < _FEWEST_CIRCLES or np.linalg.matrix_rank(relative) < 2:
        raise InputError(
            f"The pattern {pattern.name!r} has too few circles off one line to be found in a"
            f" picture; use at least a 2 x 2 grid."
        )
    steps, *_ = np.linalg.lstsq(relative, pattern.centres_mm, rcond=None)
    steps_mm = steps.T
    quarter = np.array([[0, -1], [1, 0]])
    turns = np.stack([np.linalg.matrix_power(quarter, k) for k in range(4)])
    mirrors = turns @ np.array([[-1, 0], [0, 1]])
    rings = pattern.is_ring
    ratio = pattern.inner_radius_mm[rings] / pattern.radius_mm[rings]
    turns, mirrors = _rigid(turns, steps_mm), _rigid(mirrors, steps_mm)
    return PatternSymmetry(
        circles=len(pattern),
        steps_mm=steps_mm,
        radius_mm=float(np.median(pattern.radius_mm)),
        hole_ratio=float(np.median(ratio)) if np.any(rings) else 0.0,
        turns=turns,
        mirrors=mirrors,
        symmetries=symmetries(pattern, turns),
        is_chiral=len(symmetries(pattern, mirrors)) == 0,
    )


def _rigid(
    maps: Int[np.ndarray, "k 2 2"], steps_mm: Float[np.ndarray, "2 2"]
) -> Int[np.ndarray, "rigid 2 2"]:
    """The maps of the lattice that are rotations or reflections of the sheet itself."""
    on_sheet = steps_mm @ maps @ np.linalg.inv(steps_mm)
    gram = np.swapaxes(on_sheet, 1, 2) @ on_sheet
    return maps[np.all(np.abs(gram - np.eye(2)) < 0.1, axis=(1, 2))]
