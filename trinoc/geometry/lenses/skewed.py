"""Lenses with skew as a parameter, so that the affine part of the camera is unrestricted.

Sensors have no skew. But a camera with a tilted sensor (T. Scheimpflug, 1904) is equivalent to one
with skew. So is a camera whose object points have axes that are not perpendicular. Skew is the
shear of D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971.
"""

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import BrownConrady, Pinhole, Rational, ThinPrism
from trinoc.geometry.lenses.registry import widen_lens
from trinoc.numerics.precision import ArrayLike, array_namespace

if TYPE_CHECKING:
    from typing import ClassVar as AbstractClassVar
else:
    from equinox import AbstractClassVar

SKEW = "skew_px"


class AbstractSkewedLens(AbstractLens):
    """A lens of `core_model` whose skew is a parameter, the last one of `parameters`."""

    core_model: AbstractClassVar[type[AbstractLens]]

    def __init_subclass__(cls) -> None:
        """Set the class variables: those of the core model, plus the skew."""
        super().__init_subclass__()
        cls.model = f"skewed_{cls.core_model.model}"
        cls.parameter_names = (*cls.core_model.parameter_names, SKEW)

    @property
    def parameters(self) -> Float[ArrayLike, "q"]:
        """Parameters of the core model and the skew, in the order of `parameter_names`, (q,)."""
        xp = array_namespace(self)
        return xp.append(super().parameters, self.skew_px)

    @classmethod
    def from_parameters(cls, values: Float[ArrayLike, "q"]) -> "AbstractSkewedLens":
        """Create a lens from values (q,) in the order of `parameter_names`."""
        return cls(values[:2], values[2:4], values[-1], values[4:-1])

    def with_parameters(self, values: Float[ArrayLike, "q"]) -> "AbstractSkewedLens":
        """Copy of this lens with other parameter values (q,), in the order of `parameter_names`."""
        return self.from_parameters(values)

    def parameter_scales(self, image_size_px: tuple[int, int]) -> Float[ArrayLike, "q"]:
        """Step sizes of the core model's parameters, then of the skew: the focal length, (q,)."""
        xp = array_namespace(self)
        return xp.append(super().parameter_scales(image_size_px), self.focal_length_px[0])


class SkewedThinPrism(AbstractSkewedLens, ThinPrism):
    """A `ThinPrism` lens with skew. Brown-Conrady and rational lenses are special cases of it."""

    core_model: ClassVar[type[AbstractLens]] = ThinPrism


class SkewedKannalaBrandt(AbstractSkewedLens, KannalaBrandt):
    """A `KannalaBrandt` lens with skew."""

    core_model: ClassVar[type[AbstractLens]] = KannalaBrandt


# Nested models, narrowest first: each begins with the coefficients of the previous one.
_NESTED = (BrownConrady, Rational, ThinPrism)
_SKEWED: dict[type[AbstractLens], type[AbstractSkewedLens]] = {
    KannalaBrandt: SkewedKannalaBrandt,
    **dict.fromkeys((Pinhole, *_NESTED), SkewedThinPrism),
}


def skew_lens(lens: AbstractLens) -> AbstractLens:
    """Convert a lens to the most general skewed model that includes the lens's own model.

    The projection does not change. A lens of a model without a skewed version is returned
    unchanged.
    """
    model = _SKEWED.get(type(lens))
    return lens if model is None else widen_lens(lens, model)


def straighten_lens(lens: AbstractLens, model: type[AbstractLens]) -> AbstractLens:
    """Convert a skewed lens back to the unskewed `model`; the inverse of `skew_lens`.

    If the lens has coefficients that `model` lacks and that are not zero, the result is of the next
    wider model. Other lenses are returned unchanged.
    """
    if not isinstance(lens, AbstractSkewedLens):
        return lens
    values = np.asarray(lens.coefficients)
    model_count = len(model.coefficient_names)
    wider_models = [wider for wider in _NESTED if len(wider.coefficient_names) > model_count]
    for candidate in (model, *wider_models):
        count = len(candidate.coefficient_names)
        if not values[count:].any():
            break
    return candidate(lens.focal_length_px, lens.principal_point_px, lens.skew_px, values[:count])
