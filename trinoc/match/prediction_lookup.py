"""Segments of the third view near a prediction, by the table of cells."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from trinoc.match.fragments import Prediction
from trinoc.match.picture_index import (
    SECTOR_SLACK,
    SECTORS,
    PictureIndex,
    picture_index,
    segments_at,
)
from trinoc.match.picture_lines import PictureLines

# Standard deviations within which a segment may lie of where a pair predicts it.
REACH = 4.0
# A prediction is about as uncertain as the segments themselves.
PREDICTION_SIGMAS = 1.5
# Predictions shorter than this are looked up in their middle alone.
ONE_SAMPLE_PX = 16.0
SAMPLES = (0.5, 1 / 6, 5 / 6)


class Lookup(NamedTuple):
    """The segments of a view by place and direction, and by place alone."""

    directed: PictureIndex
    undirected: PictureIndex


def lookup(lines: PictureLines, view: int, count: int) -> Lookup:
    """Tables for predictions of known and of hardly known direction."""
    ends, size = np.asarray(lines.ends_px[view])[:count], np.asarray(lines.size_px[view])
    length = np.asarray(lines.length_px[view])[:count]
    sigma = np.sqrt(np.asarray(lines.across_px2[view])[:count, [0, 1], [0, 1]].max(axis=1))
    margin = PREDICTION_SIGMAS * REACH * sigma
    slack = SECTOR_SLACK + REACH * np.sqrt(2) * sigma / length
    cell = max(8 * float(np.median(sigma)) if count else 1.0, size.max() / 192)
    return Lookup(
        picture_index(ends, slack, margin, size, cell, SECTORS),
        picture_index(ends, slack, margin, size, cell, 1),
    )


def segments_near(
    table: Lookup, guess: Prediction
) -> tuple[Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """(prediction, segment) of what passes a sample of a prediction; some more than once."""
    du, dv = guess.u1 - guess.u0, guess.v1 - guess.v0
    length = np.hypot(du, dv)
    angle = np.mod(np.arctan2(dv, du), np.pi)
    sigma_rad = np.sqrt(guess.c00 + guess.c11 - 2 * guess.c01) / length
    directed = REACH * sigma_rad < SECTOR_SLACK
    found = []
    for sample in SAMPLES:
        asked = (length > ONE_SAMPLE_PX) | (sample == 0.5)
        for index, rows in ((table.directed, directed), (table.undirected, ~directed)):
            row = np.flatnonzero(rows & asked)
            point = np.stack([guess.u0 + sample * du, guess.v0 + sample * dv], axis=1)[row]
            query, segment = segments_at(index, point, angle[row])
            found.append((row[query], segment))
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])
