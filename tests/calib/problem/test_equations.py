"""Equations of the points: derivatives of their cost, images of circles, lengths of arrays."""

import jax
import numpy as np
import pytest

from tests.calib.made_shots import (
    SIZE_PX,
    board_poses,
    lens_of,
)
from tests.calib.problem.equations import assert_equations_are_those_of_the_cost
from tests.calib.problem.made_problem import problem
from trinoc.calib.problem.board_shape import with_free_points
from trinoc.calib.problem.reprojection import BoardProjection, predict_points
from trinoc.calib.problem.views import pad_count
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.intrinsics import Intrinsics


@pytest.mark.parametrize("places_are_free", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_equations_are_those_of_the_cost(places_are_free):
    here = problem(board_poses(3))
    assert_equations_are_those_of_the_cost(with_free_points(here) if places_are_free else here)


def test_a_circle_is_predicted_as_the_exact_model_has_it():
    sheet, lens, pose = Pattern.default(), lens_of("left"), board_poses(1)[0]
    parametrization = problem(board_poses(1)).parametrization
    parametrization = type(parametrization)(**{**vars(parametrization), "has_circles": True})
    centres_mm, radius = sheet.centres_mm[:5], sheet.radius_mm[:5]
    view = BoardProjection(lens, np.eye(3, 4), pose, None, np.zeros(4))
    prediction = jax.jit(predict_points)(
        view, parametrization, 0, np.pad(centres_mm, ((0, 0), (0, 1))), np.zeros((5, 3)), radius
    )
    camera = Camera(Intrinsics.of_lens(lens, SIZE_PX), Pose(pose))
    exact = jax.jit(jax.vmap(image_of_circle_centre, (None, 0, 0)))(camera, centres_mm, radius)
    np.testing.assert_allclose(prediction, exact, atol=2e-4)


def test_lengths_of_arrays_are_few():
    padded = {pad_count(count, 8) for count in range(1, 200)}
    assert padded == {8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256}
    assert all(pad_count(count, 8) >= count for count in range(1, 200))
