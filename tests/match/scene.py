"""A small made scene as the matcher sees it, with the truth beside it."""

from typing import Any, NamedTuple

import jax
import numpy as np

from tests.match.made import loose_lines, pictures, rig_of
from trinoc.geometry.rig import Rig
from trinoc.match.observations.match_input import MatchInput, prepare

VIEWS = ("upper", "left", "right")


class MadeScene(NamedTuple):
    """Lines in space, their pictures in the caller's order, and the matcher's own tables.

    true : (n, v) the segment of each line in each view of `seen`.
    """

    rig: Rig
    lines_mm: np.ndarray
    pictures_px: dict[str, np.ndarray]
    seen: MatchInput
    true: np.ndarray

    @property
    def table(self) -> Any:
        """The padded tables, a SegmentTable of NumPy arrays."""
        return jax.tree.map(np.asarray, self.seen.lines)


def made_scene(
    *views: str, count: int, seed: int, noise_px: float = 0.0, sigma_px: float = 0.3
) -> MadeScene:
    """Whole lines in every view, with noise, of a stated standard deviation."""
    rig, lines_mm = rig_of(*views), loose_lines(count, seed)
    pictures_px = pictures(rig, lines_mm, sigma_px=noise_px, seed=seed + 1)
    return seen_by(rig, lines_mm, pictures_px, sigma_px)


def seen_by(
    rig: Rig, lines_mm: np.ndarray, pictures_px: dict[str, np.ndarray], sigma_px: float
) -> MadeScene:
    """The scene of given pictures, segment k of each of line k."""
    seen = prepare(pictures_px, rig, sigma_px)
    true = np.stack([np.argsort(order) for order in seen.order], axis=1)
    return MadeScene(rig, lines_mm, pictures_px, seen, true)


def image_px(matrix_px: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
    """Images of points: (..., 3) to (..., 2)."""
    image = points_mm @ matrix_px[:, :3].T + matrix_px[:, 3]
    return image[..., :2] / image[..., 2:]


def place_on(ends_px: np.ndarray, points_px: np.ndarray) -> np.ndarray:
    """Where points (..., k, 2) lie along segments (..., 2, 2), from 0 at the first end to 1."""
    step = (ends_px[..., 1, :] - ends_px[..., 0, :])[..., None, :]
    return ((points_px - ends_px[..., :1, :]) * step).sum(-1) / (step**2).sum(-1)
