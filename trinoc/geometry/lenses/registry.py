"""Registry of lens models by name, and conversions between models."""

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
# Model of coefficients without a model name, and of an ideal lens whose distortion is to be
# estimated.
DEFAULT_DISTORTION = BrownConrady
# Option value if no model is named: DEFAULT_DISTORTION, or a wider model if that one folds.
DEFAULT_LENS = "default"


def lens_model(name: str) -> type[AbstractLens]:
    """Return the lens class for a model name. Raise `InputError` for an unknown name."""
    if not isinstance(name, str) or name not in LENS_MODELS:
        raise InputError(
            f"The lens model is {name!r}, but must be one of {', '.join(LENS_MODELS)}."
        )
    return LENS_MODELS[name]


def promote_lens(
    lens: AbstractLens, model: type[AbstractLens] = DEFAULT_DISTORTION
) -> AbstractLens:
    """Convert a pinhole lens to `model` with all distortion coefficients zero.

    A lens with distortion is returned unchanged.
    """
    if lens.has_distortion:
        return lens
    zeros = np.zeros(len(model.coefficient_names))
    return model(lens.focal_length_px, lens.principal_point_px, lens.skew_px, zeros)


def widen_lens(lens: AbstractLens, model: type[AbstractLens]) -> AbstractLens:
    """Convert a lens to a model with more coefficients; the added coefficients are 0.

    The projection does not change. The first coefficients of `model` must be those of the lens's
    model.
    """
    zeros = np.zeros(len(model.coefficient_names) - len(lens.coefficient_names))
    coefficients = np.append(np.asarray(lens.coefficients), zeros)
    return model(lens.focal_length_px, lens.principal_point_px, lens.skew_px, coefficients)


def simplify_lens(lens: AbstractLens) -> AbstractLens:
    """Return an equal lens of the simplest possible model.

    A splined lens with a correction of zero becomes its core. A lens with all coefficients zero
    becomes a pinhole.
    """
    if isinstance(lens, AbstractSplinedLens) and not np.any(np.asarray(lens.control_px)):
        lens = lens.core
    if not lens.zero_is_ideal or np.any(np.asarray(lens.coefficients) != 0.0):
        return lens
    none = np.zeros(0)
    return Pinhole(lens.focal_length_px, lens.principal_point_px, lens.skew_px, none)


def spline_lens(lens: AbstractLens, image_size_px: tuple[int, int]) -> AbstractSplinedLens:
    """Add a spline correction of zero to a lens, which a fit may then estimate.

    Raise `InputError` if the model has no splined version.
    """
    core = promote_lens(lens)
    if type(core) not in SPLINED:
        raise InputError(
            f"The lens model {core.model} takes no correction by splines. Use one of "
            f"{', '.join(each.model for each in SPLINED)}."
        )
    return SPLINED[type(core)].of_core(core, image_size_px)


def stack_lenses(lenses: Sequence[AbstractLens]) -> AbstractLens:
    """Stack lenses of one model along a new first axis of every array.

    Pinhole lenses among them are first converted to that model. Raise `InputError` if the lenses
    have two different models with distortion.
    """
    models = {type(lens) for lens in lenses if lens.has_distortion}
    if not all(model.zero_is_ideal for model in models):
        models |= {type(lens) for lens in lenses}
    if len(models) > 1:
        raise InputError(
            f"Lenses of the models {' and '.join(sorted(model.model for model in models))} cannot "
            "be fitted together. Give lenses of one model; ideal lenses may be among them."
        )
    promoted = [promote_lens(lens, model) for model in models for lens in lenses] or list(lenses)
    xp = array_namespace(promoted)
    return jax.tree.map(lambda *leaves: xp.stack([xp.asarray(leaf) for leaf in leaves]), *promoted)
