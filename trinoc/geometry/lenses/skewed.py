"""Lenses whose skew is fitted: the affine part of a camera is then any that a matrix may have.

Sensors have no skew, but the camera whose sensor is tilted against its lens (T. Scheimpflug, 1904)
is one with skew, and so is one that is seen over places whose axes are not perpendicular. It is
the shear of D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971.
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
    """A lens that is its `core_model`, whose `parameters` end with the skew."""

    core_model: AbstractClassVar[type[AbstractLens]]

    def __init_subclass__(cls) -> None:
        """Says of the lens what its core says, and that its skew is a parameter."""
        super().__init_subclass__()
        cls.model = f"skewed_{cls.core_model.model}"
        cls.parameter_names = (*cls.core_model.parameter_names, SKEW)

    @property
    def parameters(self) -> Float[ArrayLike, "q"]:
        """Values of `parameter_names`."""
        xp = array_namespace(self)
        return xp.append(super().parameters, self.skew_px)

    @classmethod
    def from_parameters(cls, values: Float[ArrayLike, "q"]) -> "AbstractSkewedLens":
        """A lens from the values of `parameter_names`."""
        return cls(values[:2], values[2:4], values[-1], values[4:-1])

    def with_parameters(self, values: Float[ArrayLike, "q"]) -> "AbstractSkewedLens":
        """This lens with other values of `parameter_names`."""
        return self.from_parameters(values)

    def parameter_scales(self, image_size_px: tuple[int, int]) -> Float[ArrayLike, "q"]:
        """Those of the core, and a focal length: skew moves a corner as that along v does."""
        xp = array_namespace(self)
        return xp.append(super().parameter_scales(image_size_px), self.focal_length_px[0])


class SkewedThinPrism(AbstractSkewedLens, ThinPrism):
    """`ThinPrism` with skew: it has Brown-Conrady's and the rational lens within it."""

    core_model: ClassVar[type[AbstractLens]] = ThinPrism


class SkewedKannalaBrandt(AbstractSkewedLens, KannalaBrandt):
    """`KannalaBrandt` with skew."""

    core_model: ClassVar[type[AbstractLens]] = KannalaBrandt


# From the one that contains least; each has the coefficients of those before it first.
_NESTED = (BrownConrady, Rational, ThinPrism)
_SKEWED: dict[type[AbstractLens], type[AbstractSkewedLens]] = {
    KannalaBrandt: SkewedKannalaBrandt,
    **dict.fromkeys((Pinhole, *_NESTED), SkewedThinPrism),
}


def skew_lens(lens: AbstractLens) -> AbstractLens:
    """The lens as one of the widest model that contains it, whose skew is a parameter; as it is
    where its model has none such."""
    model = _SKEWED.get(type(lens))
    return lens if model is None else widen_lens(lens, model)


def straighten_lens(lens: AbstractLens, model: type[AbstractLens]) -> AbstractLens:
    """Inverse of `skew_lens`: the lens as one of `model`, or of the next that its coefficients
    need."""
    if not isinstance(lens, AbstractSkewedLens):
        return lens
    values = np.asarray(lens.coefficients)
    least = len(model.coefficient_names)
    for each in (model, *(wider for wider in _NESTED if len(wider.coefficient_names) > least)):
        count = len(each.coefficient_names)
        if not values[count:].any():
            break
    return each(lens.focal_length_px, lens.principal_point_px, lens.skew_px, values[:count])
