"""Search for lattices among the blobs: cells of four blobs, extended with a homography.

The ellipse of a circle gives the local affine map from sheet to image, up to a rotation. In the
frame in which a blob is the unit circle, its neighbours therefore have known distances, for every
tilt of the sheet.
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

# numerical: largest number of rounds; a lattice grows by one or two cells to each side in each.
_ROUNDS = 30
# numerical: limits a search: more than the eight neighbours of a circle.
_MOST_NEIGHBOURS = 12


class Lattice(NamedTuple):
    """Blobs with their lattice coordinates.

    The coordinates are unique up to a rotation and a shift.

    Attributes
    ----------
    blob : (m,) indices of the blobs.
    cell : (m, 2) lattice coordinates, with the handedness of the pattern unless the image is
        mirrored.
    """

    blob: Int[np.ndarray, "m"]
    cell: Int[np.ndarray, "m 2"]

    def __len__(self) -> int:
        return len(self.blob)


def find_lattices(
    blobs: Blobs, symmetry: PatternSymmetry, tuning: CalibTuning
) -> Iterator[Lattice]:
    """Yield lattices among the blobs of an image.

    A lattice has at least `tuning.detection.fewest_places` blobs. A blob is in one lattice only.

    Parameters
    ----------
    blobs : blobs of the image.
    symmetry : the pattern with the steps of its lattice.
    tuning : tuned constants of calibration.
    """
    # Largest number of cells of a lattice along each axis.
    span = int(np.ptp(symmetry.pattern.lattice, axis=0).max()) + 3
    relation = _Neighbours.of(blobs, symmetry, tuning)
    free = np.ones(len(blobs), dtype=bool)
    tried = np.zeros(len(blobs), dtype=bool)
    # Start with blobs inside the sheet, which have a neighbour on every side.
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
    """Pairs of blobs that may be neighbours in a lattice, for n blobs.

    Attributes
    ----------
    is_neighbour : (n, n) mask of the pairs whose distance and areas are plausible.
    offset : (n, n, 2) position of the second blob in the frame in which the first blob is the unit
        circle.
    degree : (n,) number of possible neighbours of each blob.
    expected : (2,) distances of neighbours along both lattice axes, in radii of a circle.
    cosine : cosine of the angle between the lattice axes on the sheet.
    """

    is_neighbour: np.ndarray
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
        is_neighbour = (ratio < largest) & (ratio > 1 / largest)
        is_neighbour &= (mean > step.min() / factor) & (mean < step.max() * factor)
        cosine = float(steps[:, 0] @ steps[:, 1] / np.prod(step))
        return cls(is_neighbour, offset, is_neighbour.sum(axis=1), step, cosine)

    def cells_at(self, start: int, free: np.ndarray) -> Iterator[Lattice]:
        """Yield lattices of four blobs that form one cell with the blob `start` as a corner.

        free : mask of the blobs that are not yet used.
        """
        neighbours = np.flatnonzero(self.is_neighbour[start] & free)
        # The nearest first: with a wrong radius of the pattern, diagonals could pass as rows.
        offset = self.offset[start, neighbours]
        nearest = np.argsort(offset[:, 0] ** 2 + offset[:, 1] ** 2)[:_MOST_NEIGHBOURS]
        neighbours = neighbours[nearest]
        tries = 0
        for first in neighbours.tolist():
            for second in neighbours.tolist():
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
        # Rows of an image run downward: X to Y turns clockwise, and the cross product is < 0.
        if a[0] * b[1] - a[1] * b[0] >= 0:
            return False
        stretch = (length_a / self.expected[0]) / (length_b / self.expected[1])
        if not 1 / 1.45 < stretch < 1.45:
            return False
        return bool(abs((a @ b) / (length_a * length_b) - self.cosine) < 0.45)

    def _opposite(self, start: int, first: int, second: int, free: np.ndarray) -> int | None:
        """Index of the blob at the corner of the cell opposite to `start`; None without one.

        first, second : blobs at the other two corners.
        free : mask of the blobs that are not yet used.
        """
        target = self.offset[start, first] + self.offset[start, second]
        distance = np.linalg.norm(self.offset[start] - target, axis=1)
        distance[~(free & self.is_neighbour[first] & self.is_neighbour[second])] = np.inf
        distance[start] = np.inf
        nearest = int(np.argmin(distance))
        return nearest if distance[nearest] < 0.45 * np.hypot(*target) else None


def _grow(
    blobs: Blobs,
    symmetry: PatternSymmetry,
    corner: Lattice,
    free: np.ndarray,
    span: int,
    tuning: CalibTuning,
) -> Lattice:
    """Extend a cell to a lattice.

    Blobs at predicted positions are added and the mapping is refitted, until no blob is added.

    corner : lattice of one cell.
    free : mask of the blobs that are not yet used.
    span : largest number of circles that a lattice may have along each axis.
    """
    inverse_shape = np.linalg.inv(blobs.shape_px2)
    a11, a12, a22 = (inverse_shape[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    log_area = 0.5 * np.log(np.linalg.det(blobs.shape_px2))
    log_circle = -2.0 * np.log(symmetry.pitch_radii)
    lattice = corner
    for _ in range(_ROUNDS):
        mapping = fit_plane_mapping(
            lattice.cell.astype(float), blobs.centres_px[lattice.blob], tuning=tuning
        )
        cells = _cells_around(lattice.cell, span, reach=1 if len(lattice) < 8 else 2)
        cells = np.concatenate([lattice.cell, cells])
        predicted = mapping.apply(cells.astype(float))
        is_finite = np.isfinite(predicted[:, 0])
        cells, predicted = cells[is_finite], predicted[is_finite]
        log_enlargement = mapping.log_enlargement(cells.astype(float))
        dx = blobs.centres_px[None, :, 0] - predicted[:, None, 0]
        dy = blobs.centres_px[None, :, 1] - predicted[:, None, 1]
        distance2 = (a11 * dx + 2.0 * a12 * dy) * dx + a22 * dy * dy
        wrong_size = np.abs(log_area[None] - (log_enlargement + log_circle)[:, None])
        distance2[(wrong_size > np.log(tuning.detection.area_factor)) | ~free[None]] = np.inf
        nearest = np.argmin(distance2, axis=1)
        best_cell = np.argmin(distance2, axis=0)
        index = np.arange(len(cells))
        is_accepted = (distance2[index, nearest] < tuning.detection.miss_radii**2) & (
            best_cell[nearest] == index
        )
        grown = Lattice(nearest[is_accepted], cells[is_accepted])
        if len(grown) < 4 or _is_flat(grown.cell):
            break
        is_unchanged = np.array_equal(np.sort(grown.blob), np.sort(lattice.blob))
        lattice = grown
        if is_unchanged or len(lattice) == len(symmetry.pattern):
            break
    return lattice


def _cells_around(cell: Int[np.ndarray, "m 2"], span: int, reach: int) -> Int[np.ndarray, "k 2"]:
    """Unoccupied lattice positions within `reach` of the occupied positions `cell`.

    The extent of the lattice along each axis stays below `span`.
    """
    low, high = cell.min(axis=0), cell.max(axis=0)
    shape = high - low + 1 + 2 * reach
    occupied = np.zeros(shape, dtype=np.uint8)
    occupied[tuple((cell - low + reach).T)] = 1
    dilated = cv2.dilate(occupied, np.ones((2 * reach + 1,) * 2, dtype=np.uint8))
    border = np.argwhere(dilated > occupied) - reach + low
    fits = np.all((border >= high - span + 1) & (border <= low + span - 1), axis=1)
    return border[fits]


def _is_flat(cell: Int[np.ndarray, "m 2"]) -> bool:
    """True if all lattice positions lie on one line."""
    relative = cell - cell.mean(axis=0)
    spread = relative.T @ relative
    return bool(np.linalg.det(spread) < 0.2)
