"""Light that no polynomial follows: each block of the sheet has its own, and a veil of its own.

A block is what lies nearest to one circle. Its six numbers, light and veil with their slopes,
are known to no other block, so that they are eliminated one block at a time.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from trinoc.calib.photometric.outlines import project_to_image
from trinoc.calib.targets import Pattern, SquareSheet
from trinoc.geometry import AbstractLens, Pose
from trinoc.numerics import point_tree

LOCAL_TERMS = 6
# Weak priors, of shares of the light and of grey levels: (1, x, y) each.
WIDTH = np.array([0.5, 0.1, 0.1, 40.0, 20.0, 20.0])
# Light that is left in the darkest shade: only this keeps the model from failing.
_LEAST_LIGHT = 0.05


class Blocks(NamedTuple):
    """Which block each pixel belongs to.

    Fields
    ------
    of_pixel : (n,) index of the block.
    basis : (3, n) of each pixel (1, x, y) about its block's middle, in half pitches.
    count : number of blocks.
    """

    of_pixel: Int[np.ndarray, "n"]
    basis: Float[np.ndarray, "3 n"]
    count: int

    def light(self, levels: Float[np.ndarray, "6 b"]) -> Float[np.ndarray, "n"]:
        """Factor of the light at each pixel."""
        return 1 + np.sum(levels[:3, self.of_pixel] * self.basis, axis=0)

    def veil(self, levels: Float[np.ndarray, "6 b"]) -> Float[np.ndarray, "n"]:
        """Grey levels that are added at each pixel."""
        return np.sum(levels[3:, self.of_pixel] * self.basis, axis=0)

    def part(self, chosen: Int[np.ndarray, "m"]) -> "Blocks":
        """Of some pixels only."""
        return Blocks(self.of_pixel[chosen], self.basis[:, chosen], self.count)


def blocks_of_pixels(
    uv_px: Int[np.ndarray, "n 2"], pose: Pose, lens: AbstractLens, pattern: Pattern | SquareSheet
) -> Blocks:
    """The nearest circle of each pixel."""
    middle = np.asarray(project_to_image(pose, lens, pattern.centres_mm))
    tree = point_tree(middle)
    block = np.asarray(tree.query(uv_px)[1])
    half_pitch = 0.5 * float(np.median(np.asarray(tree.query(middle, 2)[0])[:, 1]))
    offset = (uv_px - middle[block]) / half_pitch
    return Blocks(block, np.stack([np.ones(len(uv_px)), *offset.T]), len(middle))


class Elimination(NamedTuple):
    """Normal equations without the local levels, and how those follow the rest.

    Fields
    ------
    matrix, gradient : (k, k) and (k,).
    constant : (b, 6) step of the levels where the rest stays.
    by_rest : (b, 6, k) its change by a step of the rest, both to be subtracted.
    """

    matrix: Float[np.ndarray, "k k"]
    gradient: Float[np.ndarray, "k"]
    constant: Float[np.ndarray, "b 6"]
    by_rest: Float[np.ndarray, "b 6 k"]

    def stepped(
        self, levels: Float[np.ndarray, "6 b"], step: Float[np.ndarray, "k"]
    ) -> Float[np.ndarray, "6 b"]:
        """The levels after a step of the rest."""
        after = levels - (self.constant + self.by_rest @ step).T
        after[0] = np.maximum(after[0], _LEAST_LIGHT - 1)
        return after


def local_rows(
    blocks: Blocks, by_light: Float[np.ndarray, "n"], by_veil: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "6 n"]:
    """Derivatives of each pixel's grey level by the levels of its block."""
    return np.concatenate([by_light * blocks.basis, by_veil * blocks.basis])


def eliminate_local(
    blocks: Blocks,
    rows: Float[np.ndarray, "k n"],
    local: Float[np.ndarray, "6 n"],
    weight: Float[np.ndarray, "n"],
    residual: Float[np.ndarray, "n"],
    levels: Float[np.ndarray, "6 b"],
    matrix: Float[np.ndarray, "k k"],
    gradient: Float[np.ndarray, "k"],
) -> Elimination:
    """The Schur complement of every block's levels."""
    count, pixels = blocks.count, np.arange(len(weight))
    weighted = (rows * weight).T
    across = np.stack(
        [
            scipy.sparse.csr_matrix((row, (blocks.of_pixel, pixels)), (count, len(pixels)))
            @ weighted
            for row in local
        ],
        axis=1,
    )

    def summed(values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "b"]:
        return np.bincount(blocks.of_pixel, values, minlength=count)

    inner = np.array([[summed(weight * one * other) for other in local] for one in local])
    inner = np.moveaxis(inner, 2, 0) + np.diag(WIDTH**-2)
    side = np.stack([summed(weight * row * residual) for row in local], axis=1)
    side = side + levels.T / WIDTH**2
    solved = np.linalg.solve(inner, np.concatenate([across, side[:, :, None]], axis=2))
    by_rest, constant = solved[:, :, :-1], solved[:, :, -1]
    return Elimination(
        matrix - np.einsum("bik,bil->kl", across, by_rest),
        gradient - np.einsum("bik,bi->k", across, constant),
        constant,
        by_rest,
    )
