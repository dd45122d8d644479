"""The table that a sheet lies on: wood, so that the picture round the paper is not one grey."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.synth.coverage import coverage_of_cells, coverage_of_points
from trinoc.synth.shapes import Shape

# Wave numbers (rad/mm) across and along the grain, and phases: nothing repeats within a picture.
_GRAIN = np.array(
    [[0.31, 0.011, 0.3], [0.73, 0.017, 1.9], [1.27, -0.023, 4.1], [0.083, 0.006, 2.2]]
)


class Table(eqx.Module):
    """Wood outside a figure, its reflectance changing by a tenth along the grain."""

    sheet: Shape
    reflectance: float

    @property
    def local(self) -> bool:
        """False: it fills the picture."""
        return False

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """What was below inside the sheet, wood elsewhere."""
        level = self.sheet.level_mm(points_mm)
        share = coverage_of_cells(level) if cells else coverage_of_points(level)
        wood = np.full(grey.shape, self.reflectance)
        seen = np.isfinite(level) & (share < 1.0)
        phase = points_mm[seen] @ _GRAIN[:, 1::-1].T + _GRAIN[:, 2]
        wood[seen] *= 1 + 0.1 * np.mean(np.sin(phase), axis=-1)
        return wood + share * (grey - wood)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """The sheet's outline."""
        return self.sheet.outline_mm(step_mm)
