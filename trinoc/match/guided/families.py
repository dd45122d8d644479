"""Families of lines of nearly one direction."""

import numpy as np
from jaxtyping import Float, Int


def family_of(
    unit: Float[np.ndarray, "t 3"], length: Float[np.ndarray, "t"], same_deg: float
) -> Int[np.ndarray, "t"]:
    """The family of each line: of those not in one yet the longest makes the next, with all that
    are parallel to it within `same_deg`."""
    family = np.full(len(unit), -1)
    for line in np.argsort(-length, kind="stable").tolist():
        if family[line] < 0:
            alike = np.abs(unit @ unit[line]) > np.cos(np.radians(same_deg))
            family[alike & (family < 0)] = family.max() + 1
    return family


def largest_families(
    family: Int[np.ndarray, "t"], length: Float[np.ndarray, "t"], count: int
) -> Int[np.ndarray, "k"]:
    """Of the longest families of three lines or more, the line of median length."""
    number, total = np.bincount(family), np.bincount(family, length)
    largest = [k for k in np.argsort(-total, kind="stable").tolist() if number[k] >= 3][:count]
    members = [np.flatnonzero(family == k) for k in largest]
    middle = [own[np.argsort(length[own], kind="stable")[len(own) // 2]] for own in members]
    return np.array(middle, dtype=np.int64)


def first_of_each(key: Int[np.ndarray, "n"]) -> Int[np.ndarray, "k"]:
    """The first row of each key, in the order of the keys' own rows."""
    return np.sort(np.unique(key, return_index=True)[1])
