"""Which segments of a picture pass a point in about a direction: a table of cells.

The place that a pair predicts in a third view is known to a fraction of a pixel, the direction
of a short pair only to degrees: so the table goes by place first, in square cells that a
segment enters wherever it passes, and by direction in sectors second.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.intervals import expand_ranges

SECTORS = 12
SECTOR = np.pi / SECTORS
# Predictions whose direction is known to this (rad, all told) look into one sector.
SECTOR_SLACK = np.radians(6.0)


class PictureIndex(NamedTuple):
    """Segments sorted by cell: key = (row * columns + column) * sectors + sector.

    start : first entry of each key, and the end of the last. segment : the entries.
    """

    cell_px: float
    columns: int
    rows: int
    sectors: int
    start: Int[np.ndarray, "keys"]
    segment: Int[np.ndarray, "entries"]


def picture_index(
    ends_px: Float[np.ndarray, "n 2 2"],
    slack_rad: Float[np.ndarray, "n"],
    margin_px: Float[np.ndarray, "n"],
    size_px: Float[np.ndarray, "2"],
    cell_px: float,
    sectors: int,
) -> PictureIndex:
    """Enter each segment in every cell it passes within `margin_px`, in each sector in which
    a direction within `slack_rad` of its own lies; `sectors` of 1 leaves direction out."""
    columns, rows = (int(np.ceil(side / cell_px)) for side in size_px)
    owner, column, row = _cells_passed(ends_px, margin_px, cell_px)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    owner, key = owner[inside], row[inside] * columns + column[inside]
    if sectors > 1:
        step = ends_px[:, 1] - ends_px[:, 0]
        angle, slack = np.arctan2(step[:, 1], step[:, 0]), np.minimum(slack_rad, np.pi / 2.001)
        first = np.floor((angle - slack) / SECTOR).astype(int)
        last = np.minimum(np.floor((angle + slack) / SECTOR).astype(int), first + sectors - 1)
        entry, sector = expand_ranges(first[owner], last[owner] + 1)
        owner, key = owner[entry], key[entry] * sectors + np.mod(sector, sectors)
    order = np.argsort(key, kind="stable")
    start = np.searchsorted(key[order], np.arange(rows * columns * sectors + 1))
    return PictureIndex(cell_px, columns, rows, sectors, start, owner[order])


def _cells_passed(
    ends_px: Float[np.ndarray, "n 2 2"], margin_px: Float[np.ndarray, "n"], cell_px: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(segment, column, row) of every cell within the margin of a segment, and of a few more."""
    steep = np.abs(ends_px[:, 1, 1] - ends_px[:, 0, 1]) > np.abs(
        ends_px[:, 1, 0] - ends_px[:, 0, 0]
    )
    # Walk along the longer side: u for a flat segment, v for a steep one.
    walk = np.where(steep[:, None], ends_px[..., 1], ends_px[..., 0])
    other = np.where(steep[:, None], ends_px[..., 0], ends_px[..., 1])
    low, high = walk.min(axis=1), walk.max(axis=1)
    slope = (other[:, 1] - other[:, 0]) / (walk[:, 1] - walk[:, 0])
    owner, along = expand_ranges(
        np.floor((low - margin_px) / cell_px).astype(int),
        np.floor((high + margin_px) / cell_px).astype(int) + 1,
    )

    def other_at(place: np.ndarray) -> np.ndarray:
        reached = np.clip(place, low[owner], high[owner])
        return other[owner, 0] + slope[owner] * (reached - walk[owner, 0])

    left, right = other_at(along * cell_px), other_at((along + 1) * cell_px)
    # Across a slanting segment the margin is longer along the rows or columns.
    margin = (margin_px * np.sqrt(1 + slope**2))[owner]
    entry, across = expand_ranges(
        np.floor((np.minimum(left, right) - margin) / cell_px).astype(int),
        np.floor((np.maximum(left, right) + margin) / cell_px).astype(int) + 1,
    )
    owner, along = owner[entry], along[entry]
    return owner, np.where(steep[owner], across, along), np.where(steep[owner], along, across)


def segments_at(
    index: PictureIndex, points_px: Float[np.ndarray, "q 2"], angle_rad: Float[np.ndarray, "q"]
) -> tuple[Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """(query, segment) for every segment entered where a query looks."""
    column = np.floor(points_px[:, 0] / index.cell_px).astype(int)
    row = np.floor(points_px[:, 1] / index.cell_px).astype(int)
    inside = (column >= 0) & (column < index.columns) & (row >= 0) & (row < index.rows)
    key = np.where(inside, row * index.columns + column, 0)
    if index.sectors > 1:
        key = key * index.sectors + np.minimum((angle_rad / SECTOR).astype(int), SECTORS - 1)
    start = index.start[key]
    owner, position = expand_ranges(start, np.where(inside, index.start[key + 1], start))
    return owner, index.segment[position]
