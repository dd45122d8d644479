"""Which parameters of a lens are fitted, and in which directions a fit may change it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.geometry import AbstractLens


class LensModel(NamedTuple):
    """Which parameters of the lens are fitted; the others are held.

    Fields
    ------
    lens : the lens's model.
    distortion : names of the free coefficients, in the order of `lens.coefficient_names`.
    principal_point : whether cx and cy are free.
    aspect : whether fx and fy are free one by one; their ratio is held otherwise.
    """

    lens: type[AbstractLens]
    distortion: tuple[str, ...]
    principal_point: bool = True
    aspect: bool = True

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that are not held, in the order of `lens.parameter_names`.

        Where the aspect is held, "fx_px" stands for both focal lengths.
        """
        held = set(self.lens.coefficient_names) - set(self.distortion)
        held |= set() if self.principal_point else {"cx_px", "cy_px"}
        held |= set() if self.aspect else {"fy_px"}
        return tuple(name for name in self.lens.parameter_names if name not in held)

    def without(self, coefficient: str) -> "LensModel":
        """This model with one coefficient held."""
        return self._replace(
            distortion=tuple(name for name in self.distortion if name != coefficient)
        )


def free_directions(model: LensModel) -> Float[np.ndarray, "q q"]:
    """Columns: the change of all scaled parameters of the lens with each one that is free.

    Columns of held parameters are zero, so that all models share one compiled program.
    """
    names = model.lens.parameter_names
    directions = np.diag([float(name in model.free) for name in names])
    if not model.aspect:
        directions[names.index("fy_px"), names.index("fx_px")] = 1.0
    return directions
