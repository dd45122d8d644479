"""Step 1: triples of segments that can be one line, from all three orderings of the views."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.arrays import ArrayLike
from trinoc.match.ends import end_evidence
from trinoc.match.fragments import PairFragment, predict
from trinoc.match.intervals import overlapping
from trinoc.match.likelihood import TripleEvidence, triple_evidence
from trinoc.match.padding import blocks, bucket, padded
from trinoc.match.pencil import Pencil, pencil
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
PAIRS_PER_BLOCK = 1 << 18
# Below this many pixels of half length, one sample stands for the whole prediction.
ONE_SAMPLE_PX = 8.0
SAMPLES = (0.0, -2 / 3, 2 / 3)


class Candidates(NamedTuple):
    """Triples that can be one line; rows of each array belong together.

    index : segment in each of the views (-1 in views that take no part).
    part : common part on each segment. ends_mm : ends in space.
    """

    index: Int[np.ndarray, "m v"]
    part: Float[np.ndarray, "m v 2"]
    ends_mm: Float[np.ndarray, "m 2 3"]
    chi_square: Float[np.ndarray, "m"]
    log_density: Float[np.ndarray, "m"]
    end_log: Float[np.ndarray, "m 2 c"]


class _Indices(NamedTuple):
    fine: PictureIndex
    coarse: PictureIndex


def trinocular_candidates(
    lines: PictureLines, views: tuple[int, int, int], counts: list[int]
) -> Candidates:
    """All triples of three views; each is found from the pair of views that crosses best."""
    log_strangers, typical_px = strangers(lines, counts)
    parts = []
    for c in range(3):
        order = (views[(c + 1) % 3], views[(c + 2) % 3], views[c])
        indices = _indices(lines, order[2], counts[order[2]])
        planes = pencil(lines, np.array(order[0]), np.array(order[1]))
        for i, j in _pairs(planes, counts[order[0]], counts[order[1]]):
            parts.append(
                _from_pairs(lines, order, planes, indices, log_strangers, typical_px, i, j)
            )
    return Candidates(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def strangers(lines: PictureLines, counts: list[int]) -> tuple[np.ndarray, float]:
    """(log of segments per pixel of area and radian in each view, typical length in px)."""
    density, lengths = [], []
    for view, count in enumerate(counts):
        middle = np.asarray(lines.ends_px[view])[:count].mean(axis=1)
        lengths.append(np.asarray(lines.length_px[view])[:count])
        area = float(np.prod(np.asarray(lines.size_px[view])))
        if count > 2:
            # Segments often fill only a part of the picture: that of a box with their spread.
            spread = np.sqrt(np.linalg.det(np.cov(middle.T)))
            area = min(area, max(12 * float(spread), 1e-3 * area))
        density.append(np.log(max(count, 1) / (np.pi * area)))
    return np.array(density), float(np.median(np.concatenate(lengths)))


def _indices(lines: PictureLines, view: int, count: int) -> _Indices:
    ends, size = np.asarray(lines.ends_px[view])[:count], np.asarray(lines.size_px[view])
    length = np.asarray(lines.length_px[view])[:count]
    sigma = np.sqrt(np.asarray(lines.across_px2[view])[:count, [0, 1], [0, 1]].max(axis=1))
    margin = 1.5 * REACH * sigma
    slack = SECTOR_SLACK + REACH * np.sqrt(2) * sigma / length
    cell = max(8 * float(np.median(sigma)) if count else 1.0, size.max() / 192)
    return _Indices(
        picture_index(ends, slack, margin, size, cell, SECTORS),
        picture_index(ends, slack, margin, size, cell, 1),
    )


def _pairs(
    planes: Pencil, count_a: int, count_b: int
) -> Iterator[tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]]:
    """Pairs that share epipolar planes, in blocks of segments of the first view."""
    angles_a = np.asarray(planes.angles_a)[:count_a]
    angles_b = np.asarray(planes.angles_b)[:count_b]
    rows = max(1, PAIRS_PER_BLOCK // max(count_b // 4, 1))
    for block in blocks(count_a, rows):
        i, j = overlapping(angles_a[block], angles_b)
        yield i + block.start, j


def _from_pairs(
    lines: PictureLines,
    order: tuple[int, int, int],
    planes: Pencil,
    indices: _Indices,
    log_strangers: np.ndarray,
    typical_px: float,
    i: Int[np.ndarray, "p"],
    j: Int[np.ndarray, "p"],
) -> Candidates:
    size = bucket(len(i))
    views = np.array(order)
    guess = _predicted(lines, views, planes, padded(i, size), padded(j, size))
    guess = PairFragment(*(np.asarray(field)[: len(i)] for field in guess))
    keep = np.flatnonzero(guess.possible)
    i, j, guess = i[keep], j[keep], PairFragment(*(field[keep] for field in guess))
    pair, k = _third_segments(indices, guess)
    size = bucket(len(pair))
    segments = np.stack([i[pair], j[pair], k], axis=1)
    found, end_log = _judged(
        lines,
        views,
        padded(segments, size),
        padded(guess.ends_mm[pair], size, 1.0),
        log_strangers,
        typical_px,
    )
    keep = np.flatnonzero(np.asarray(found.possible)[: len(pair)])
    segments, pair = segments[keep], pair[keep]
    # Several samples of one prediction may find one segment.
    _, once = np.unique(pair * (k.max(initial=0) + 1) + segments[:, 2], return_index=True)
    keep, segments = keep[once], segments[once]
    index = np.full((len(keep), len(lines.size_px)), -1)
    part = np.zeros((len(keep), len(lines.size_px), 2))
    index[:, views] = segments
    part[:, views] = np.asarray(found.part)[keep]
    return Candidates(
        index,
        part,
        np.asarray(found.ends_mm)[keep],
        np.asarray(found.chi_square)[keep],
        np.asarray(found.log_density)[keep],
        np.asarray(end_log)[keep],
    )


@jax.jit
def _predicted(
    lines: PictureLines,
    views: Int[ArrayLike, "3"],
    planes: Pencil,
    i: Int[ArrayLike, "p"],
    j: Int[ArrayLike, "p"],
) -> PairFragment:
    return jax.vmap(predict, in_axes=(None, None, None, 0, 0))(lines, views, planes, i, j)


def _third_segments(
    indices: _Indices, guess: PairFragment
) -> tuple[Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """(pair, segment of the third view) where the table has one at a sample of the prediction."""
    direction = np.stack([np.cos(guess.angle_rad), np.sin(guess.angle_rad)], axis=1)
    narrow = REACH * np.asarray(guess.sigma_rad) < SECTOR_SLACK
    found = []
    for sample in SAMPLES:
        asked = (guess.half_length_px > ONE_SAMPLE_PX) | (sample == 0.0)
        point = guess.middle_px + sample * np.asarray(guess.half_length_px)[:, None] * direction
        for index, rows in ((indices.fine, narrow & asked), (indices.coarse, ~narrow & asked)):
            row = np.flatnonzero(rows)
            query, segment = segments_at(index, point[row], np.asarray(guess.angle_rad)[row])
            found.append((row[query], segment))
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])


@jax.jit
def _judged(
    lines: PictureLines,
    views: Int[ArrayLike, "3"],
    segments: Int[ArrayLike, "h 3"],
    ends_mm: Float[ArrayLike, "h 2 3"],
    log_strangers: Float[ArrayLike, "v"],
    typical_px: Float[ArrayLike, ""],
) -> tuple[TripleEvidence, Float[ArrayLike, "h 2 c"]]:
    judge = jax.vmap(triple_evidence, in_axes=(None, None, 0, 0, None, None))
    evidence = judge(lines, views, segments, ends_mm, log_strangers, typical_px)
    return evidence, jax.vmap(end_evidence)(evidence.extent_px)
