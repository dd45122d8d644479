"""Cylinders and rims as lines that any tool draws: circles in chords, and lines along a mantle."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match import Cylinders, Rims


class Wires(NamedTuple):
    """places_mm : of all points. pairs : the two points of each piece. owner : its body."""

    places_mm: Float[np.ndarray, "n 3"]
    pairs: Int[np.ndarray, "e 2"]
    owner: Int[np.ndarray, "e"]


def wires_of(bodies: Cylinders | Rims) -> Wires:
    """The pieces of `Cylinders.wires_mm` or `Rims.circles_mm`, in order."""
    if isinstance(bodies, Rims):
        # Each ends where it begins.
        lines = [(row, np.concatenate([c, c[:1]])) for row, c in enumerate(bodies.circles_mm())]
    else:
        lines = [(row, wire) for row, own in enumerate(bodies.wires_mm()) for wire in own]
    places = np.concatenate([np.zeros((0, 3)), *(wire for _, wire in lines)])
    count = np.array([len(wire) for _, wire in lines], dtype=np.int64)
    first = np.ones(len(places), dtype=bool)
    first[np.cumsum(count) - 1] = False
    start = np.flatnonzero(first)
    owner = np.repeat(np.array([row for row, _ in lines], dtype=np.int64), count)
    return Wires(places, np.stack([start, start + 1], axis=1), owner[start])
