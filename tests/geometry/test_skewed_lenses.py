"""Skewed lenses image as the lenses from which they are made, and convert back to them."""

import jax
import numpy as np
import pytest

from trinoc.geometry.lenses.registry import LENS_MODELS
from trinoc.geometry.lenses.skewed import AbstractSkewedLens, skew_lens, straighten_lens
from trinoc.geometry.lenses.splined import SPLINED

MODELS = [model for model in LENS_MODELS.values() if model not in SPLINED.values()]
every_model = pytest.mark.parametrize("model", MODELS, ids=lambda model: model.model)
RAY = np.array([0.12, -0.07, 1.0])


def example(model):
    coefficients = 0.01 * np.arange(1.0, len(model.coefficient_names) + 1)
    affine = np.array([900.0, 920.0]), np.array([250.0, 243.0]), np.array(2.5)
    return model(*affine, coefficients)


@every_model
def test_they_image_as_what_they_come_from_and_go_back(model):
    lens = example(model)
    skewed = skew_lens(lens)
    assert isinstance(skewed, AbstractSkewedLens)
    np.testing.assert_allclose(skewed.project_ray(RAY), lens.project_ray(RAY), rtol=1e-14)
    back = straighten_lens(skewed, model)
    assert type(back) is model
    assert jax.tree.all(jax.tree.map(np.array_equal, back, lens))


@every_model
def test_the_skew_is_the_last_parameter_and_moves_pixels_along_u(model):
    skewed = skew_lens(example(model))
    names = skewed.parameter_names
    assert names[: len(model.parameter_names)] == model.parameter_names
    assert names[-1] == "skew_px"
    assert len(names) == len(skewed.parameters) == len(skewed.parameter_scales((512, 480)))
    assert skewed.parameters[-1] == 2.5
    step = np.zeros(len(names))
    step[-1] = 4.0
    moved = skewed.retract(step)
    along_u = np.array([4.0 * float(skewed.distort(RAY)[1]), 0.0])
    np.testing.assert_allclose(
        np.asarray(moved.project_ray(RAY)) - np.asarray(skewed.project_ray(RAY)),
        along_u,
        atol=1e-10,
    )


def test_coefficients_that_a_model_lacks_take_the_next_that_has_them():
    skewed = skew_lens(example(LENS_MODELS["none"]))
    wider = skewed.with_parameters(np.array(skewed.parameters) + np.eye(17)[9])
    assert straighten_lens(wider, LENS_MODELS["brown_conrady"]).model == "rational"


def test_other_lenses_stay_as_they_are():
    splined = next(iter(SPLINED.values()))
    lens = example(splined)
    assert skew_lens(lens) is lens
    assert straighten_lens(lens, splined) is lens
