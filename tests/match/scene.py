"""A small synthetic scene with the matcher's input and the truth."""

from typing import Any, NamedTuple

import jax
import numpy as np

from tests.match.made import loose_lines, pictures, rig_of
from trinoc.geometry.rig import Rig
from trinoc.match.observations.match_input import MatchInput, prepare

VIEWS = ("upper", "left", "right")


class MadeScene(NamedTuple):
    """Lines in space, their pictures in the caller's order, and the matcher's input.

    true : (n, v) the segment of each line in each view of `inputs`.
    """

    rig: Rig
    lines_mm: np.ndarray
    pictures_px: dict[str, np.ndarray]
    inputs: MatchInput
    true: np.ndarray

    @property
    def table(self) -> Any:
        """Padded SegmentTable of NumPy arrays."""
        return jax.tree.map(np.asarray, self.inputs.lines)


def made_scene(
    *views: str, count: int, seed: int, noise_px: float = 0.0, sigma_px: float = 0.3
) -> MadeScene:
    """Scene of lines that every view shows in full. `sigma_px` is stated, `noise_px` is true."""
    rig, lines_mm = rig_of(*views), loose_lines(count, seed)
    pictures_px = pictures(rig, lines_mm, sigma_px=noise_px, seed=seed + 1)
    return seen_by(rig, lines_mm, pictures_px, sigma_px)


def seen_by(
    rig: Rig, lines_mm: np.ndarray, pictures_px: dict[str, np.ndarray], sigma_px: float
) -> MadeScene:
    """Scene of these pictures, whose segments k show line k."""
    inputs = prepare(pictures_px, rig, sigma_px)
    true = np.stack([np.argsort(order) for order in inputs.order], axis=1)
    return MadeScene(rig, lines_mm, pictures_px, inputs, true)


def image_px(matrix_px: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
    """Images of points: (..., 3) to (..., 2)."""
    image = points_mm @ matrix_px[:, :3].T + matrix_px[:, 3]
    return image[..., :2] / image[..., 2:]


def place_on(ends_px: np.ndarray, points_px: np.ndarray) -> np.ndarray:
    """Positions of points (..., k, 2) along segments (..., 2, 2), from 0 at the first end to 1."""
    step = (ends_px[..., 1, :] - ends_px[..., 0, :])[..., None, :]
    return ((points_px - ends_px[..., :1, :]) * step).sum(-1) / (step**2).sum(-1)
