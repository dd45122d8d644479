"""Whether a picture shows an edge at a known place and in a known direction.

All windows of blocks, and all lines within the gate, shifted across, are tests of their own, and
are counted. Of the edges that are sure the nearest to the known place is taken, since others may
lie beside it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.pixels.edge_piece import Extent, Place, estimate_extent, locate_edge
from trinoc.match.pixels.probes import (
    BLOCKS,
    REACH,
    SHOULDER,
    WINDOW_FIRST,
    WINDOW_LAST,
    WINDOW_SIZE,
    Samples,
    block_gradients,
    ridge,
    ridge_sigma,
    whole_windows,
    window_spread,
    windows,
)
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.tables import take_rows
from trinoc.numerics.tails import normal_limit

# numerical: places of the lines across, px.
_ACROSS = np.arange(-REACH, REACH + 1)


class WindowEvidence(NamedTuple):
    """Of probes that show anything, the window of blocks and the line that shows an edge best.

    Fields
    ------
    probe : (n,) which of the probes.
    score : (n,) the sum of its ridge in standard deviations, without sign.
    sign : (n,) +1 where it is brighter on the right.
    extent, place : along the probe, and across.
    excess : (n,) sigma of its blocks over what the picture's noise makes of them, at least 1.
    tests : (n,) windows and lines that were looked at.
    """

    probe: Int[np.ndarray, "n"]
    score: Float[np.ndarray, "n"]
    sign: Float[np.ndarray, "n"]
    extent: Extent
    place: Place
    excess: Float[np.ndarray, "n"]
    tests: Float[np.ndarray, "n"]


class Band(NamedTuple):
    """The gradient about each probe.

    Fields
    ------
    across, along : (n, o, b) at all offsets. height : (n, r, b) ridge of `across`.
    sigma : (n,) of one block's. known : (n, b) whether a block is inside.
    """

    across: Float[np.ndarray, "n o b"]
    along: Float[np.ndarray, "n o b"]
    height: Float[np.ndarray, "n r b"]
    sigma: Float[np.ndarray, "n"]
    known: Bool[np.ndarray, "n b"]


class Tests(NamedTuple):
    """Of windows x on the lines r: score : (n, r, x), with sign. whole : whether it was one at
    all."""

    score: Float[np.ndarray, "n r x"]
    whole: Bool[np.ndarray, "n r x"]


def search_windows(
    by_uv: Float[np.ndarray, "2 h w"],
    least: float,
    growth: Float[np.ndarray, "k"],
    places: Samples,
    gate_px: Float[np.ndarray, "n"],
    near_px: Float[np.ndarray, "n"],
    latest: Int[np.ndarray, "n"],
) -> WindowEvidence:
    """The best window of each probe that begins at block `latest` or before, within the gate.

    `near_px` is the standard deviation of the line's place, `least` that of a block's ridge from
    the picture's noise, and `growth` is g(n) of every window's size.
    """
    band = prepare_band(by_uv, least, places)
    tests = sum_windows(band, growth, gate_px, latest)
    number = tests.whole.sum(axis=(1, 2))
    limit = normal_limit(DEFAULT.guided.weak / 2 / np.maximum(number, 1))
    size = np.where(tests.whole, np.abs(tests.score), 0.0).max(axis=(1, 2))
    probe = np.flatnonzero(size > limit)
    band, tests = take_rows((band, tests), probe)
    good = tests.whole & is_edge(band, tests)
    best = nearest_of_surest(tests.score, good, near_px[probe])
    row = np.flatnonzero(good.any(axis=(1, 2)))
    band = take_rows(band, row)
    line, window = np.divmod(best[row], tests.score.shape[2])
    score, probe = tests.score[row, line, window], probe[row]
    sign = np.sign(score).astype(np.float64)
    extent, place = measure_piece(band, line, window, sign, growth)
    return WindowEvidence(
        probe,
        np.abs(score).astype(np.float64),
        sign,
        extent,
        place,
        band.sigma / least,
        number[probe].astype(np.float64),
    )


def prepare_band(by_uv: Float[np.ndarray, "2 h w"], least: float, places: Samples) -> Band:
    """What the picture shows about each probe."""
    across, along, known = block_gradients(by_uv, places)
    height = ridge(across)
    return Band(across, along, height, ridge_sigma(height, known, least), known)


def sum_windows(
    band: Band,
    growth: Float[np.ndarray, "k"],
    gate_px: Float[np.ndarray, "n"],
    latest: Int[np.ndarray, "n"],
) -> Tests:
    """The sum of the ridge over every window on every line."""
    sums = windows(band.height) / band.sigma[:, None, None]
    begins = (latest[:, None] >= WINDOW_FIRST) & whole_windows(band.known)
    near = np.abs(_ACROSS) <= gate_px[:, None]
    return Tests(sums / window_spread(growth), near[..., None] & begins[:, None])


def is_edge(band: Band, tests: Tests) -> Bool[np.ndarray, "n r x"]:
    """Whether the gradient across is largest on a line itself, and hardly any goes along it."""
    across = windows(band.across[:, SHOULDER - 1 : 1 - SHOULDER])
    size, own = np.abs(across), across[:, 1:-1]
    top = (size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] >= size[:, 2:])
    along = np.abs(windows(band.along[:, SHOULDER:-SHOULDER]))
    straight = along < DEFAULT.guided.oblique_share * np.abs(own)
    return top & straight & ((own > 0) == (tests.score > 0))


def nearest_of_surest(
    score: Float[np.ndarray, "n r x"],
    good: Bool[np.ndarray, "n r x"],
    near_px: Float[np.ndarray, "n"],
) -> Int[np.ndarray, "n"]:
    """Line and window as one number: of edges that are sure the nearest, of others the surest."""
    size = np.abs(score)
    off = _ACROSS / np.maximum(near_px, 0.3)[:, None]
    value = np.minimum(size, DEFAULT.guided.sure_score) ** 2 + 2 * np.log1p(size)
    value = np.where(good, value - (off**2)[..., None], -np.inf)
    count, lines, kinds = score.shape
    return value.reshape(count, lines * kinds).argmax(axis=1)


def measure_piece(
    band: Band,
    line: Int[np.ndarray, "n"],
    window: Int[np.ndarray, "n"],
    sign: Float[np.ndarray, "n"],
    growth: Float[np.ndarray, "k"],
) -> tuple[Extent, Place]:
    """The edge that shows best in one window on one line: as far as it goes on, and its place."""
    own = (sign / band.sigma)[:, None] * band.height[np.arange(len(line)), line]
    blocks = np.arange(BLOCKS)
    inside = (blocks >= WINDOW_FIRST[window, None]) & (blocks <= WINDOW_LAST[window, None])
    mean = (own * inside).sum(axis=1) / WINDOW_SIZE[window]
    half = WINDOW_FIRST[window] + WINDOW_SIZE[window] // 2
    extent = estimate_extent(own, mean, band.known, half, growth[0])
    across = sign[:, None, None] * band.across
    return extent, locate_edge(across, line - REACH, extent, growth[2] * band.sigma**2)
