"""How the command line says which edges of a picture become segments."""

import dataclasses
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from trinoc.geometry import Segments


@dataclasses.dataclass(frozen=True, kw_only=True)
class SegmentOptions:
    """Options of every command that finds segments."""

    tolerance_px: float = 1.6
    """Coarsest deviation of an edge from a straight line."""

    false_alarms: float = 1.0
    """How many segments noise alone may bring about in a picture."""

    least_contrast: float = 7.0
    """Fainter edges are left out; in grey levels of 0 to 255."""

    arcs: bool = False
    """Keep the chords of arcs, such as the rims of cylinders: more of the scene is seen, less
    exactly."""

    def find(self, image: "np.ndarray") -> "Segments":
        """The segments of a picture."""
        from trinoc.segments import find_segments

        return find_segments(
            image,
            tolerance_px=self.tolerance_px,
            false_alarms=self.false_alarms,
            least_contrast=self.least_contrast,
            arcs=self.arcs,
        )
