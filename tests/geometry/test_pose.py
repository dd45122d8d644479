"""Laws of the retraction of a pose under every pose model."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings

from tests.geometry.strategies import cameras, vectors
from trinoc.errors import InputError
from trinoc.geometry import Pose
from trinoc.geometry.pose import PoseModel, pose_model_over_sheet
from trinoc.geometry.rotation import (
    cayley_rotation,
    rotation_from_vector,
    vector_from_rotation,
)

UNIT_MM = 470.0
every_model = pytest.mark.parametrize("model", PoseModel)
few = settings(max_examples=10)
retract = jax.jit(Pose.retract, static_argnames=("model",))
parameters_of = jax.jit(Pose.model_parameters, static_argnames=("model",))
d_parameters_d_delta = jax.jit(Pose.d_parameters_d_delta, static_argnames=("model",))


@every_model
@few
@given(camera=cameras())
def test_a_step_of_zero_leaves_the_pose(model, camera):
    zero = np.zeros(model.size)
    unmoved = retract(camera.pose, zero, model=model, unit_mm=UNIT_MM)
    np.testing.assert_allclose(unmoved.cam_from_world, camera.cam_from_world, atol=1e-9)


@every_model
@few
@given(camera=cameras(), six=vectors(6, 0.01))
def test_a_step_does_what_the_model_says(model, camera, six):
    delta, pose = six[: model.size], camera.pose
    after = retract(pose, delta, model=model, unit_mm=UNIT_MM)
    turn = cayley_rotation(delta[:3])
    np.testing.assert_allclose(after.rotation, turn @ pose.rotation, atol=1e-12)
    np.testing.assert_allclose(after.rotation @ after.rotation.T, np.eye(3), atol=1e-12)
    if model is PoseModel.RIGID:
        moved = after.centre_world_mm - pose.centre_world_mm
        np.testing.assert_allclose(moved, UNIT_MM * delta[3:], atol=1e-9)
        return
    shift = UNIT_MM * delta[4:] if model is PoseModel.AIM_FREE else np.zeros(2)
    np.testing.assert_allclose(after.aim_mm - pose.aim_mm, shift, atol=1e-8)
    np.testing.assert_allclose(after.distance_mm - pose.distance_mm, UNIT_MM * delta[3], atol=1e-8)


@every_model
@few
@given(camera=cameras())
def test_the_jacobian_of_the_parameters_is_the_limit_of_differences(model, camera):
    pose = camera.pose
    exact = d_parameters_d_delta(pose, model=model, unit_mm=UNIT_MM, origin=pose)

    def value(delta):
        after = retract(pose, delta, model=model, unit_mm=UNIT_MM)
        return parameters_of(after, model=model, origin=pose)

    for k in range(model.size):
        step = 1e-6 * np.eye(model.size)[k]
        turn = np.array(value(step) - value(-step))
        turn[:3] = (turn[:3] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(exact[:, k], turn / 2e-6, rtol=1e-5, atol=1e-4)


@given(vectors(3, 0.8))
def test_the_rotation_vector_survives_its_rotation(vector):
    np.testing.assert_allclose(
        vector_from_rotation(rotation_from_vector(vector)), vector, atol=1e-12
    )


@few
@given(cameras())
def test_an_aimed_pose_looks_at_the_origin_from_the_same_place_of_the_sheet(camera):
    aimed = camera.pose.aim_at_origin()
    np.testing.assert_allclose(aimed.aim_mm, 0.0, atol=1e-9)
    np.testing.assert_allclose(aimed.centre_world_mm, camera.centre_world_mm, atol=1e-9)


def test_a_model_is_said_by_itself_or_by_its_word():
    for model in PoseModel:
        assert PoseModel.of(model) is PoseModel.of(model.option_name) is model
        assert len(model.parameter_names) == model.size
    assert pose_model_over_sheet("aim-free") is PoseModel.AIM_FREE


@pytest.mark.parametrize(
    ("pose_model", "message"),
    [("free", "must be one of"), ("rigid", "aim-free")],
)
def test_what_is_no_model_over_a_sheet_is_refused(pose_model, message):
    with pytest.raises(InputError, match=message):
        pose_model_over_sheet(pose_model)
