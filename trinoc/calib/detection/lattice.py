"""Blobs that lie as the lattice of the sheet does: cells of four, grown by a homography.

A circle's image, a small ellipse, is the affine image of the sheet round it up to a rotation.
In units of a blob's own ellipse its neighbours therefore lie a known distance away, however
the sheet is tilted.
"""

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detection.blobs import Blobs
from trinoc.calib.detection.ellipse_pixels import inverse_square_root
from trinoc.calib.detection.labels import PatternSymmetry
from trinoc.calib.detection.plane_mapping import fit_plane_mapping
from trinoc.calib.tuning.every_group import CalibTuning

# numerical: a lattice grows by a cell to each side in a round, and ends when it does no more.
_ROUNDS = 30
# numerical: bounds a search: more than the eight about a circle.
_MOST_BESIDE = 12


class Lattice(NamedTuple):
    """Blobs with lattice coordinates that are right up to a turn and a shift.

    blob : (m,) index of the blobs.
    cell : (m, 2) lattice coordinates; unless the picture is mirrored they turn as the
        pattern's do.
    """

    blob: Int[np.ndarray, "m"]
    cell: Int[np.ndarray, "m 2"]

    def __len__(self) -> int:
        return len(self.blob)


def find_lattices(
    blobs: Blobs, symmetry: PatternSymmetry, tuning: CalibTuning
) -> Iterator[Lattice]:
    """Lattices of a few blobs at least, each blob used once, as they are found."""
    # Cells of a lattice along each axis, at most.
    span = int(np.ptp(symmetry.pattern.lattice, axis=0).max()) + 3
    relation = _Neighbours.of(blobs, symmetry, tuning)
    free = np.ones(len(blobs), dtype=bool)
    tried = np.zeros(len(blobs), dtype=bool)
    # Blobs amid the sheet have a neighbour on every side: start there.
    for start in np.argsort(-relation.degree, kind="stable"):
        if not free[start] or tried[start] or relation.degree[start] < 2:
            continue
        for corner in relation.cells_at(int(start), free):
            tried[corner.blob] = True
            lattice = _grow(blobs, symmetry, corner, free, span, tuning)
            if len(lattice) >= tuning.detection.fewest_places:
                free[lattice.blob] = False
                yield lattice
                break


class _Neighbours(NamedTuple):
    """Pairs of blobs that may be neighbours, and where each lies in the other's frame."""

    near: np.ndarray
    offset: Float[np.ndarray, "n n 2"]
    degree: Int[np.ndarray, "n"]
    expected: Float[np.ndarray, "2"]
    cosine: float

    @classmethod
    def of(cls, blobs: Blobs, symmetry: PatternSymmetry, tuning: CalibTuning) -> "_Neighbours":
        frame = inverse_square_root(blobs.shape_px2)
        between = blobs.centres_px[None] - blobs.centres_px[:, None]
        offset = between @ frame
        distance = np.sqrt(offset[..., 0] ** 2 + offset[..., 1] ** 2)
        mean = np.sqrt(distance * distance.T)
        steps = symmetry.steps_mm / symmetry.radius_mm
        step = np.linalg.norm(steps, axis=0)
        area = np.sqrt(np.linalg.det(blobs.shape_px2))
        ratio = area[:, None] / area[None]
        largest, factor = tuning.detection.largest_area_ratio, tuning.detection.distance_factor
        near = (ratio < largest) & (ratio > 1 / largest)
        near &= (mean > step.min() / factor) & (mean < step.max() * factor)
        cosine = float(steps[:, 0] @ steps[:, 1] / np.prod(step))
        return cls(near, offset, near.sum(axis=1), step, cosine)

    def cells_at(self, start: int, free: np.ndarray) -> Iterator[Lattice]:
        """Four blobs round one cell of the lattice with `start` as a corner."""
        beside = np.flatnonzero(self.near[start] & free)
        # The nearest first: where the stated radius is off, diagonals could pass for rows.
        offset = self.offset[start, beside]
        beside = beside[np.argsort(offset[:, 0] ** 2 + offset[:, 1] ** 2)[:_MOST_BESIDE]]
        tries = 0
        for first in beside.tolist():
            for second in beside.tolist():
                if first == second or not self._spans_cell(start, first, second):
                    continue
                opposite = self._opposite(start, first, second, free)
                if opposite is not None:
                    yield Lattice(
                        np.array([start, first, second, opposite]),
                        np.array([[0, 0], [1, 0], [0, 1], [1, 1]]),
                    )
                    tries += 1
                    if tries == 4:
                        return

    def _spans_cell(self, start: int, first: int, second: int) -> bool:
        a, b = self.offset[start, first], self.offset[start, second]
        length_a, length_b = np.hypot(*a), np.hypot(*b)
        # Rows run downward in a picture, so X to Y turns clockwise: the cross product is < 0.
        if a[0] * b[1] - a[1] * b[0] >= 0:
            return False
        stretch = (length_a / self.expected[0]) / (length_b / self.expected[1])
        if not 1 / 1.45 < stretch < 1.45:
            return False
        return bool(abs((a @ b) / (length_a * length_b) - self.cosine) < 0.45)

    def _opposite(self, start: int, first: int, second: int, free: np.ndarray) -> int | None:
        """The blob that closes the parallelogram, if one does."""
        target = self.offset[start, first] + self.offset[start, second]
        miss = np.linalg.norm(self.offset[start] - target, axis=1)
        miss[~(free & self.near[first] & self.near[second])] = np.inf
        miss[start] = np.inf
        nearest = int(np.argmin(miss))
        return nearest if miss[nearest] < 0.45 * np.hypot(*target) else None


def _grow(
    blobs: Blobs,
    symmetry: PatternSymmetry,
    corner: Lattice,
    free: np.ndarray,
    span: int,
    tuning: CalibTuning,
) -> Lattice:
    """Add the blobs that lie where the lattice predicts them, refit, and look further."""
    inverse_shape = np.linalg.inv(blobs.shape_px2)
    a11, a12, a22 = (inverse_shape[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    log_area = 0.5 * np.log(np.linalg.det(blobs.shape_px2))
    log_circle = -2.0 * np.log(symmetry.pitch_radii)
    lattice = corner
    for _ in range(_ROUNDS):
        mapping = fit_plane_mapping(
            lattice.cell.astype(float), blobs.centres_px[lattice.blob], tuning=tuning
        )
        cells = _cells_round(lattice.cell, span, reach=1 if len(lattice) < 8 else 2)
        cells = np.concatenate([lattice.cell, cells])
        place = mapping.apply(cells.astype(float))
        cells, place = cells[np.isfinite(place[:, 0])], place[np.isfinite(place[:, 0])]
        log_enlargement = mapping.log_enlargement(cells.astype(float))
        dx = blobs.centres_px[None, :, 0] - place[:, None, 0]
        dy = blobs.centres_px[None, :, 1] - place[:, None, 1]
        miss = (a11 * dx + 2.0 * a12 * dy) * dx + a22 * dy * dy
        wrong_size = np.abs(log_area[None] - (log_enlargement + log_circle)[:, None])
        miss[(wrong_size > np.log(tuning.detection.area_factor)) | ~free[None]] = np.inf
        nearest = np.argmin(miss, axis=1)
        best_cell = np.argmin(miss, axis=0)
        index = np.arange(len(cells))
        good = (miss[index, nearest] < tuning.detection.miss_radii**2) & (
            best_cell[nearest] == index
        )
        grown = Lattice(nearest[good], cells[good])
        if len(grown) < 4 or _is_flat(grown.cell):
            break
        same = np.array_equal(np.sort(grown.blob), np.sort(lattice.blob))
        lattice = grown
        if same or len(lattice) == len(symmetry.pattern):
            break
    return lattice


def _cells_round(cell: Int[np.ndarray, "m 2"], span: int, reach: int) -> Int[np.ndarray, "k 2"]:
    """Cells within `reach` of the known ones, no row or column getting longer than `span`."""
    low, high = cell.min(axis=0), cell.max(axis=0)
    shape = high - low + 1 + 2 * reach
    known = np.zeros(shape, dtype=np.uint8)
    known[tuple((cell - low + reach).T)] = 1
    close = cv2.dilate(known, np.ones((2 * reach + 1,) * 2, dtype=np.uint8))
    found = np.argwhere(close > known) - reach + low
    fits = np.all((found >= high - span + 1) & (found <= low + span - 1), axis=1)
    return found[fits]


def _is_flat(cell: Int[np.ndarray, "m 2"]) -> bool:
    relative = cell - cell.mean(axis=0)
    spread = relative.T @ relative
    return bool(np.linalg.det(spread) < 0.2)
