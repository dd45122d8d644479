"""A figure of cells between lines along X and along Y: chessboards, markers, grids of tags."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float


class Cells(eqx.Module):
    """Some of the cells between lines, those that touch without a seam.

    Fields
    ------
    x_mm, y_mm : rising, the lines.
    inside : (rows, columns) which cells belong to the figure, the lowest row first, those before
        the first line and after the last among them.
    """

    x_mm: Float[np.ndarray, "n"]
    y_mm: Float[np.ndarray, "m"]
    inside: Bool[np.ndarray, "_r _c"]

    def level_mm(self, points_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Distance from the nearest cell unlike the own one, up to the least width of a cell."""
        x, y = points_mm[..., 0], points_mm[..., 1]
        column, row = np.searchsorted(self.x_mm, x), np.searchsorted(self.y_mm, y)
        # Cells farther than the neighbours are no nearer than this: the level has no jump.
        far = min(float(np.diff(lines).min()) for lines in (self.x_mm, self.y_mm))
        lines_x = np.concatenate([[-np.inf], self.x_mm, [np.inf]])
        lines_y = np.concatenate([[-np.inf], self.y_mm, [np.inf]])
        across = {-1: x - lines_x[column], 0: 0.0 * x, 1: lines_x[column + 1] - x}
        along = {-1: y - lines_y[row], 0: 0.0 * y, 1: lines_y[row + 1] - y}
        around = np.pad(self.inside, 1, mode="edge")
        own, distance = self.inside[row, column], np.full(x.shape, far)
        for down in (-1, 0, 1):
            for aside in (-1, 0, 1):
                unlike = around[row + 1 + down, column + 1 + aside] != own
                away = np.hypot(across[aside], along[down])
                distance = np.where(unlike, np.minimum(distance, away), distance)
        return np.where(own, -distance, distance)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along the sides between cells that are unlike."""
        upright = _sides(self.inside, self.x_mm, self.y_mm, step_mm)
        lying = _sides(self.inside.T, self.y_mm, self.x_mm, step_mm)
        return np.concatenate([upright, lying[:, ::-1]])


def _sides(
    inside: Bool[np.ndarray, "_r _c"],
    x_mm: Float[np.ndarray, "n"],
    y_mm: Float[np.ndarray, "m"],
    step_mm: float,
) -> Float[np.ndarray, "k 2"]:
    rows, columns = np.nonzero(inside[1:-1, 1:] != inside[1:-1, :-1])
    points = [np.zeros((0, 2))]
    for row, column in zip(rows, columns, strict=True):
        low, high = y_mm[row], y_mm[row + 1]
        y = np.linspace(low, high, max(2, int(np.ceil((high - low) / step_mm)) + 1))
        points.append(np.stack([np.full(len(y), x_mm[column]), y], axis=1))
    return np.concatenate(points)
