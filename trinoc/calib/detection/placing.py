"""A lattice laid on the pattern in every turn and at every shift."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.targets import Pattern

# One circle where the pattern has none must not decide a labelling, two may; a circle misread
# as a ring or a disc costs about 25.
_OUTSIDE_COST = 10.0


class Placements(NamedTuple):
    """Ways to lay a lattice on a pattern.

    index : (k, m) pattern index of each circle of the lattice, -1 where the pattern has none.
    score : (k,) log likelihood.
    """

    index: Int[np.ndarray, "k m"]
    score: Float[np.ndarray, "k"]


def placements(
    cell: Int[np.ndarray, "m 2"],
    ring_evidence: Float[np.ndarray, "m"],
    pattern: Pattern,
    maps: Int[np.ndarray, "turns 2 2"],
) -> Placements:
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
    return Placements(index, score)


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
    return first + np.indices(last - first + 1).reshape(2, -1).T


def symmetries(pattern: Pattern, maps: Int[np.ndarray, "turns 2 2"]) -> Int[np.ndarray, "k n"]:
    """Permutations of the circles by those maps of the lattice that leave the sheet as it is.

    The identity, if `maps` holds it, comes first.
    """
    ring_evidence = np.where(pattern.is_ring, 2.0, -2.0)
    placed = placements(pattern.lattice, ring_evidence, pattern, maps)
    found = placed.index[placed.score > len(pattern) - 0.5]
    is_identity = np.all(found == np.arange(len(pattern)), axis=1)
    return found[np.argsort(~is_identity, kind="stable")]
