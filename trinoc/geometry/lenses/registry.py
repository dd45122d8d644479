"""The lens models by name, and lenses of several models brought to one."""

from collections.abc import Sequence

import jax
import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import BrownConrady, Pinhole, Rational, ThinPrism
from trinoc.geometry.lenses.splined import SPLINED, AbstractSplinedLens
from trinoc.numerics.precision import array_namespace

LENS_MODELS: dict[str, type[AbstractLens]] = {
    lens.model: lens
    for lens in (Pinhole, BrownConrady, Rational, ThinPrism, KannalaBrandt, *SPLINED.values())
}
# The model of coefficients that come without a name, and that an ideal lens is given where its
# distortion is asked for.
DEFAULT_DISTORTION = BrownConrady
# What stands for the model where none is named: that one, or a wider one if it folds an image.
DEFAULT_LENS = "default"


def lens_model(name: str) -> type[AbstractLens]:
    """The lens of a model's name. Raises InputError for one that is not known."""
    if not isinstance(name, str) or name not in LENS_MODELS:
        raise InputError(
            f"The lens model is {name!r}, but must be one of {', '.join(LENS_MODELS)}."
        )
    return LENS_MODELS[name]


def promote_lens(
    lens: AbstractLens, model: type[AbstractLens] = DEFAULT_DISTORTION
) -> AbstractLens:
    """An ideal lens as one of `model`, at whose zero it is ideal; any other as it is."""
    if lens.has_distortion:
        return lens
    zeros = np.zeros(len(model.coefficient_names))
    return model(lens.focal_length_px, lens.principal_point_px, lens.skew_px, zeros)


def widen_lens(lens: AbstractLens, model: type[AbstractLens]) -> AbstractLens:
    """A lens as one of a model whose coefficients begin with its own, and whose others are 0 where
    it is the same lens."""
    zeros = np.zeros(len(model.coefficient_names) - len(lens.coefficient_names))
    coefficients = np.append(np.asarray(lens.coefficients), zeros)
    return model(lens.focal_length_px, lens.principal_point_px, lens.skew_px, coefficients)


def simplify_lens(lens: AbstractLens) -> AbstractLens:
    """An ideal lens where all coefficients are zero and say so, the core of a splined lens without
    a correction; the lens as it is otherwise."""
    if isinstance(lens, AbstractSplinedLens) and not np.any(np.asarray(lens.control_px)):
        lens = lens.core
    if not lens.zero_is_ideal or np.any(np.asarray(lens.coefficients) != 0.0):
        return lens
    none = np.zeros(0)
    return Pinhole(lens.focal_length_px, lens.principal_point_px, lens.skew_px, none)


def spline_lens(lens: AbstractLens, image_size_px: tuple[int, int]) -> AbstractSplinedLens:
    """A lens with a correction that is zero, and may be fitted.

    Raises InputError for a model that is no core of a splined lens.
    """
    core = promote_lens(lens)
    if type(core) not in SPLINED:
        raise InputError(
            f"The lens model {core.model} takes no correction by splines: use one of "
            f"{', '.join(each.model for each in SPLINED)}."
        )
    return SPLINED[type(core)].of_core(core, image_size_px)


def stack_lenses(lenses: Sequence[AbstractLens]) -> AbstractLens:
    """Several lenses along a new first axis, ideal ones promoted to the model of the others.

    Raises InputError where they are of two models that both distort.
    """
    models = {type(lens) for lens in lenses if lens.has_distortion}
    if not all(model.zero_is_ideal for model in models):
        models |= {type(lens) for lens in lenses}
    if len(models) > 1:
        raise InputError(
            f"Lenses of the models {' and '.join(sorted(model.model for model in models))} cannot "
            "be fitted together: give lenses of one model (ideal ones may be among them)."
        )
    alike = [promote_lens(lens, model) for model in models for lens in lenses] or list(lenses)
    xp = array_namespace(alike)
    return jax.tree.map(lambda *leaves: xp.stack([xp.asarray(leaf) for leaf in leaves]), *alike)
