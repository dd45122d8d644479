"""Cylinders as lines that any tool draws: both rims in chords, and lines along the mantle."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match import Cylinders


class Wires(NamedTuple):
    """places_mm : of all points. pairs : the two points of each piece. owner : its cylinder."""

    places_mm: Float[np.ndarray, "n 3"]
    pairs: Int[np.ndarray, "e 2"]
    owner: Int[np.ndarray, "e"]


def wires_of(cylinders: Cylinders) -> Wires:
    """The pieces of `Cylinders.wires_mm`, in order."""
    lines = [(row, wire) for row, own in enumerate(cylinders.wires_mm()) for wire in own]
    places = np.concatenate([np.zeros((0, 3)), *(wire for _, wire in lines)])
    count = np.array([len(wire) for _, wire in lines], dtype=np.int64)
    first = np.ones(len(places), dtype=bool)
    first[np.cumsum(count) - 1] = False
    start = np.flatnonzero(first)
    owner = np.repeat(np.array([row for row, _ in lines], dtype=np.int64), count)
    return Wires(places, np.stack([start, start + 1], axis=1), owner[start])
