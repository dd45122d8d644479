"""Whether a picture shows an edge at a known place and in a known direction.

All windows of blocks, and all lines within the gate, shifted across and turned a little, are tests
of their own, and are counted. Of
the edges that are sure the nearest to the known place is taken, since others may lie beside it.
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

# numerical: how far the line's two ends lie on different sides of the probe, px.
TILTS = np.array([-2, 0, 2])
# numerical: places of the lines' middles across, px.
MIDDLES = np.arange(-REACH, REACH + 1, dtype=np.int8)


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


class ProbeLines(NamedTuple):
    """Lines of all tilts, and of each all middles: l of them beside every probe.

    shift : (n, t, b) what each tilt adds at every block, -1, 0 or 1 px.
    at : (n, l, b) where each line is across, px.
    """

    shift: Int[np.ndarray, "n t b"]
    at: Int[np.ndarray, "n l b"]


class Tests(NamedTuple):
    """Of windows x on lines l: score : (n, l, x), with sign. whole : whether it was one at all."""

    score: Float[np.ndarray, "n l x"]
    whole: Bool[np.ndarray, "n l x"]


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
    lines = list_lines(band.known)
    tests = sum_windows(band, lines, growth, gate_px, latest)
    number = tests.whole.sum(axis=(1, 2))
    limit = normal_limit(DEFAULT.guided.usual / 2 / np.maximum(number, 1))
    size = np.where(tests.whole, np.abs(tests.score), 0.0).max(axis=(1, 2))
    probe = np.flatnonzero(size > limit)
    band, lines, tests = take_rows((band, lines, tests), probe)
    good = tests.whole & is_edge(band, lines, tests, growth)
    best = nearest_of_surest(lines, tests.score, good, near_px[probe])
    row = np.flatnonzero(good.any(axis=(1, 2)))
    band, lines = take_rows((band, lines), row)
    line, window = np.divmod(best[row], tests.score.shape[2])
    score, probe = tests.score[row, line, window], probe[row]
    sign = np.sign(score).astype(np.float64)
    extent, place = measure_piece(band, lines, line, window, sign, gate_px[probe], growth)
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
    lines: ProbeLines,
    growth: Float[np.ndarray, "k"],
    gate_px: Float[np.ndarray, "n"],
    latest: Int[np.ndarray, "n"],
) -> Tests:
    """The sum of the ridge over every window on every line."""
    height = np.pad(band.height, ((0, 0), (1, 1), (0, 0)))
    sums = windows(on_lines(height, lines)) / band.sigma[:, None, None]
    begins = latest[:, None] >= WINDOW_FIRST
    whole = whole_windows(blocks_in_gate(lines, band.known, gate_px)) & begins[:, None]
    return Tests(sums / window_spread(growth), whole)


def is_edge(
    band: Band, lines: ProbeLines, tests: Tests, growth: Float[np.ndarray, "k"]
) -> Bool[np.ndarray, "n l x"]:
    """Whether the gradient across is largest on a line itself, and hardly any goes along it."""
    count = len(band.sigma)
    across = windows(on_lines(band.across, lines, REACH + 1))
    size = np.abs(across).reshape(count, len(TILTS), len(MIDDLES) + 2, len(WINDOW_FIRST))
    top = (size[:, :, 1:-1] >= size[:, :, :-2]) & (size[:, :, 1:-1] >= size[:, :, 2:])
    own = across.reshape(size.shape)[:, :, 1:-1].reshape(tests.score.shape)
    along = np.abs(windows(on_lines(band.along, lines)))
    noise = DEFAULT.guided.oblique_sigmas * band.sigma[:, None, None] * window_spread(growth)
    straight = along < DEFAULT.guided.oblique_share * np.abs(own) + noise
    return top.reshape(own.shape) & straight & ((own > 0) == (tests.score > 0))


def nearest_of_surest(
    lines: ProbeLines,
    score: Float[np.ndarray, "n l x"],
    good: Bool[np.ndarray, "n l x"],
    near_px: Float[np.ndarray, "n"],
) -> Int[np.ndarray, "n"]:
    """Line and window as one number: of edges that are sure the nearest, of others the surest."""
    row, line, window = np.nonzero(good)
    size = np.abs(score[row, line, window])
    ends = (lines.at[row, line, end[window]] for end in (WINDOW_FIRST, WINDOW_LAST))
    off = np.maximum(*np.abs(np.stack(list(ends)))) / np.maximum(near_px, 0.3)[row]
    value = np.full(score.shape, -np.inf)
    value[row, line, window] = (
        np.minimum(size, DEFAULT.guided.sure_score) ** 2 + 2 * np.log1p(size) - off**2
    )
    count, number, kinds = score.shape
    return value.reshape(count, number * kinds).argmax(axis=1)


def measure_piece(
    band: Band,
    lines: ProbeLines,
    line: Int[np.ndarray, "n"],
    window: Int[np.ndarray, "n"],
    sign: Float[np.ndarray, "n"],
    gate_px: Float[np.ndarray, "n"],
    growth: Float[np.ndarray, "k"],
) -> tuple[Extent, Place]:
    """The edge that shows best in one window on one line: as far as it goes on, and its place."""
    at = lines.at[np.arange(len(line)), line]
    column = np.clip(at, -REACH, REACH) + REACH
    own = np.take_along_axis(band.height, column[:, None], axis=1)[:, 0]
    own = (sign / band.sigma)[:, None] * own
    blocks = np.arange(BLOCKS)
    inside = (blocks >= WINDOW_FIRST[window, None]) & (blocks <= WINDOW_LAST[window, None])
    mean = (own * inside).sum(axis=1) / WINDOW_SIZE[window]
    usable = blocks_in_gate(lines, band.known, gate_px)[np.arange(len(line)), line]
    half = WINDOW_FIRST[window] + WINDOW_SIZE[window] // 2
    extent = estimate_extent(own, mean, usable, half, growth[0])
    across = sign[:, None, None] * band.across
    return extent, locate_edge(across, column + SHOULDER, at, extent, growth[2] * band.sigma**2)


def list_lines(known: Bool[np.ndarray, "n b"]) -> ProbeLines:
    """All lines; they are turned about the middle of what is known of the probe."""
    first = known.argmax(axis=1)[:, None]
    last = BLOCKS - 1 - known[:, ::-1].argmax(axis=1)[:, None]
    place = (np.arange(BLOCKS) - (first + last) / 2) / (last - first + 1)
    shift = np.clip(np.rint(TILTS[:, None] * place[:, None]), -1, 1).astype(np.int8)
    at = MIDDLES[:, None] + shift[:, :, None]
    return ProbeLines(shift, at.reshape(len(known), -1, BLOCKS))


def on_lines(
    part: Float[np.ndarray, "n o b"], lines: ProbeLines, reach: int = REACH
) -> Float[np.ndarray, "n l b"]:
    """What `part`, whose middle column is the probe itself, holds on lines up to `reach` across."""
    middle = part.shape[1] // 2
    left, own, right = (
        part[:, middle - reach + step : middle + reach + step + 1] for step in (-1, 0, 1)
    )
    held = [
        np.where(turn > 0, right, np.where(turn < 0, left, own))
        for turn in lines.shift.transpose(1, 0, 2)[:, :, None]
    ]
    return np.concatenate(held, axis=1)


def blocks_in_gate(
    lines: ProbeLines, known: Bool[np.ndarray, "n b"], gate_px: Float[np.ndarray, "n"]
) -> Bool[np.ndarray, "n l b"]:
    """Which blocks of each line are inside, and within the gate."""
    gate = np.minimum(gate_px, REACH)[:, None, None]
    return (np.abs(lines.at) <= gate) & known[:, None]
