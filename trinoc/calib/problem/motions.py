"""Rigid motions (3, 4) one after the other, and back."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

# Boards whose planes differ by less look parallel: focal length and distance look alike then.
PARALLEL_DEG = 8.0


def chained(second: Float[np.ndarray, "3 4"], first: Float[np.ndarray, "3 4"]) -> np.ndarray:
    """`first`, then `second`."""
    rotation = second[:, :3] @ first[:, :3]
    return np.column_stack([rotation, second[:, :3] @ first[:, 3] + second[:, 3]])


def inverse(motion: Float[np.ndarray, "3 4"]) -> np.ndarray:
    """The way back."""
    rotation = motion[:, :3].T
    return np.column_stack([rotation, -rotation @ motion[:, 3]])


def motion_in_plane(
    here_mm: Float[np.ndarray, "m 2"], there_mm: Float[np.ndarray, "m 2"]
) -> np.ndarray:
    """The motion of the plane Z = 0 in itself that takes places `there_mm` to `here_mm`."""
    here, there = here_mm - here_mm.mean(axis=0), there_mm - there_mm.mean(axis=0)
    cross = there[:, 0] @ here[:, 1] - there[:, 1] @ here[:, 0]
    angle = np.arctan2(cross, np.sum(there * here))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    motion = np.eye(3, 4)
    motion[:2, :2] = turn
    motion[:2, 3] = here_mm.mean(axis=0) - turn @ there_mm.mean(axis=0)
    return motion


def boards_parallel(poses: Sequence[Float[np.ndarray, "3 4"]]) -> bool:
    """Whether boards at these poses are parallel to each other, of which there are several."""
    facing = np.array([pose[:, 2] for pose in poses])
    between = np.degrees(np.arccos(np.clip(np.abs(facing @ facing[0]), 0.0, 1.0)))
    return len(facing) > 1 and bool(between.max() < PARALLEL_DEG)
