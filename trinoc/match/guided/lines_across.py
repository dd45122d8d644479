"""Lines beside a probe, shifted across and turned a little: each is a test of its own."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.guided.probes import BLOCKS
from trinoc.match.guided.ridges import REACH

# How far the line's two ends lie on different sides of the probe, px.
TILTS = np.array([-2, 0, 2])
# Places of the lines' middles across, px.
MIDDLES = np.arange(-REACH, REACH + 1, dtype=np.int8)


class Lines(NamedTuple):
    """Lines of all tilts, and of each all middles: l of them beside every probe.

    shift : (n, t, b) what each tilt adds at every block, -1, 0 or 1 px.
    at : (n, l, b) where each line is across, px.
    """

    shift: Int[np.ndarray, "n t b"]
    at: Int[np.ndarray, "n l b"]


def lines_at(known: Bool[np.ndarray, "n b"]) -> Lines:
    """All lines; they are turned about the middle of what is known of the probe."""
    first = known.argmax(axis=1)[:, None]
    last = BLOCKS - 1 - known[:, ::-1].argmax(axis=1)[:, None]
    place = (np.arange(BLOCKS) - (first + last) / 2) / (last - first + 1)
    shift = np.clip(np.rint(TILTS[:, None] * place[:, None]), -1, 1).astype(np.int8)
    at = MIDDLES[:, None] + shift[:, :, None]
    return Lines(shift, at.reshape(len(known), -1, BLOCKS))


def on_lines(
    part: Float[np.ndarray, "n o b"], lines: Lines, reach: int = REACH
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


def within(
    lines: Lines, known: Bool[np.ndarray, "n b"], gate_px: Float[np.ndarray, "n"]
) -> Bool[np.ndarray, "n l b"]:
    """Which blocks of each line are inside, and within the gate."""
    gate = np.minimum(gate_px, REACH)[:, None, None]
    return (np.abs(lines.at) <= gate) & known[:, None]
