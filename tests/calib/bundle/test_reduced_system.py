"""The reduced system is that of all unknowns together, and its parts are true derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

from tests.calib.bundle.made_tracks import TRUTH, made_tracks, rig_at
from tests.geometry.strategies import vectors
from trinoc.calib import CameraState, camera_state, stacked_states
from trinoc.calib.bundle.line_residual import whitening_across
from trinoc.calib.bundle.line_retraction import moved_anchors, normals_of
from trinoc.calib.bundle.schur import (
    FragmentTable,
    fragment_distances,
    normal_equations,
    robust_costs,
    track_blocks,
)
from trinoc.calib.model import camera_of_state
from trinoc.geometry import PoseModel
from trinoc.numerics import GemanMcClure, eliminate

blocks_of = jax.jit(jax.vmap(track_blocks, (None, 0, 0, None)))
equations = jax.jit(normal_equations)
whiten = jax.jit(jax.vmap(jax.vmap(whitening_across)))

LOSS = GemanMcClure.from_scale(4.0)
EVERYTHING = GemanMcClure.from_scale(1e6)  # a loss so wide that it is the plain sum of squares


def states(pose_model, with_intrinsics=False):
    rig = rig_at(TRUTH, with_covariance=False)
    each = [camera_state(c, pose_model, with_intrinsics=with_intrinsics) for c in rig.cameras]
    return stacked_states(each), rig


def tracks_of(lines):
    fragments = np.where(lines.seen[:, :, None, None], lines.fragments_px, [[0.0, 0], [1, 0]])
    return FragmentTable(fragments, whiten(fragments, lines.covariance_px2), lines.seen)


@given(vectors(3, 1.0).filter(lambda d: np.linalg.norm(d) > 0.1))
def test_normals_complete_a_basis(direction):
    basis = np.vstack([direction / np.linalg.norm(direction), normals_of(direction)])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)


def test_the_chart_moves_anchors_across_the_line_only():
    anchors = np.array([[1.0, 2, 3], [4, 6, 3]])
    np.testing.assert_allclose(moved_anchors(anchors, np.zeros(4)), anchors)
    moved = np.asarray(moved_anchors(anchors, np.array([0.1, -0.2, 0.3, 0.4]))) - anchors
    np.testing.assert_allclose(moved @ (anchors[1] - anchors[0]), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), [np.hypot(0.1, 0.2), 0.5])


@pytest.mark.parametrize("pose_model", PoseModel)
@pytest.mark.parametrize("with_intrinsics", [False, True])
def test_a_step_of_zero_moves_nothing_and_others_are_differentiable(pose_model, with_intrinsics):
    cameras, rig = states(pose_model, with_intrinsics)
    first = jax.tree.map(lambda leaf: leaf[0], cameras)
    count = len(first.names)
    at_rest = first.retract(jnp.zeros(count))
    np.testing.assert_allclose(at_rest.matrix_px, rig["upper"].matrix_px, rtol=1e-12, atol=1e-9)
    again = camera_of_state(at_rest, rig["upper"])
    np.testing.assert_allclose(again.matrix_px, rig["upper"].matrix_px, rtol=1e-12, atol=1e-9)

    by_step = jax.jit(lambda: first.d_parameters_d_delta(first))()
    parameters = jax.jit(lambda step: first.retract(step).parameters(first))
    for i in range(count):
        delta = 1e-6 * np.eye(count)[i]
        difference = (parameters(delta) - parameters(-delta)) / 2e-6
        np.testing.assert_allclose(by_step[:, i], difference, rtol=1e-6, atol=1e-6)


def test_whitening_makes_the_distances_independent():
    lines, _, _ = made_tracks(0, 1)
    fragment, covariance = lines.fragments_px[0, 0], lines.covariance_px2[0, 0]
    whitening = whitening_across(fragment, covariance)
    along = np.diff(fragment, axis=0)[0]
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    rows = np.kron(np.eye(2), normal)
    np.testing.assert_allclose(
        whitening @ rows @ covariance @ rows.T @ whitening.T, np.eye(2), atol=1e-9
    )


def test_eliminating_the_lines_solves_the_whole_problem():
    """Step and covariance of the Schur complement are those of the dense normal equations."""
    lines, _, _ = made_tracks(1, 7, hidden=0.0)
    cameras, _ = states(PoseModel.RIGID)
    tracks, anchors = tracks_of(lines), jnp.asarray(lines.lines_mm)
    views, size = 3, 6

    @jax.jit
    def residual(vector):
        moved = jax.vmap(CameraState.retract)(cameras, vector[: views * size].reshape(views, size))
        placed = jax.vmap(moved_anchors)(anchors, vector[views * size :].reshape(-1, 4))
        by_view = jax.vmap(fragment_distances, (0, None, 0, 0))
        return jax.vmap(by_view, (None, 0, 0, 0))(moved, placed, *tracks[:2]).reshape(-1)

    zero = jnp.zeros(views * size + 4 * len(lines))
    jacobian, value = np.asarray(jax.jit(jax.jacfwd(residual))(zero)), np.asarray(residual(zero))
    prior = np.zeros((len(zero), len(zero)))
    prior[: views * size, : views * size] = 1e4 * np.eye(views * size)
    dense = jacobian.T @ jacobian + prior
    step = -np.linalg.solve(dense, jacobian.T @ value)

    blocks = blocks_of(cameras, anchors, tracks, EVERYTHING)
    arrow, gradient = equations(blocks, tracks.seen, 0.0)
    elimination = jax.jit(eliminate)(arrow)
    information = np.asarray(elimination.reduced) + 1e4 * np.eye(views * size)
    camera_step = -np.linalg.solve(information, elimination.reduced_side(gradient))
    np.testing.assert_allclose(camera_step, step[: views * size], rtol=1e-5, atol=1e-9)
    line_step = elimination.blocks_of(camera_step, -gradient[1])
    np.testing.assert_allclose(line_step.reshape(-1), step[views * size :], rtol=1e-5, atol=1e-8)
    covariance = np.linalg.inv(dense)[: views * size, : views * size]
    np.testing.assert_allclose(np.linalg.inv(information), covariance, rtol=1e-5, atol=1e-12)


def test_two_views_of_a_line_say_nothing_about_the_cameras():
    lines, _, _ = made_tracks(2, 7, hidden=1.0)
    cameras, _ = states(PoseModel.RIGID)
    tracks = tracks_of(lines)
    blocks = blocks_of(cameras, lines.lines_mm, tracks, EVERYTHING)
    for leaf in jax.tree.leaves(equations(blocks, tracks.seen, 0.0)):
        np.testing.assert_array_equal(leaf, 0)


def test_the_gradient_of_the_system_is_that_of_the_cost():
    lines, _, _ = made_tracks(3, 7, hidden=0.0)
    cameras, _ = states(PoseModel.AIM_FREE)
    tracks = tracks_of(lines)

    def cost(steps):
        moved = jax.vmap(CameraState.retract)(cameras, steps.reshape(3, 6))
        return jnp.sum(robust_costs(moved, lines.lines_mm, tracks, LOSS))

    blocks = blocks_of(cameras, lines.lines_mm, tracks, LOSS)
    gradient = 2 * np.sum(blocks.camera_gradient, axis=0).reshape(-1)
    np.testing.assert_allclose(
        gradient, jax.jit(jax.grad(cost))(jnp.zeros(18)), rtol=1e-8, atol=1e-6
    )
