"""The equations of cameras and lines equal the derivatives of their cost, in every part."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from jax.flatten_util import ravel_pytree

from tests.calib.bundle.made_tracks import NAMES, SHEET_SIGMA, TRUTH, made_tracks, rig_at
from tests.geometry.strategies import vectors
from trinoc.calib.bundle.camera import camera_of_state, camera_state, stack_states
from trinoc.calib.bundle.estimate import (
    FIXED_SIGMA,
    FreeParameters,
    prior_information,
)
from trinoc.calib.bundle.factors import (
    PosePrior,
    complete_basis,
    line_residual,
    retract_line,
    whiten_across,
)
from trinoc.calib.bundle.joint_problem import (
    CamerasAndLines,
    FragmentTable,
    JointProblem,
    squared_distances,
    with_lines_of_two_views,
)
from trinoc.geometry import LineObservations
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import Rig
from trinoc.numerics.block_arrow import eliminate
from trinoc.numerics.robust_loss import GemanMcClure

COUNT = 7
LOSS = GemanMcClure.from_scale(jnp.asarray(4.0))
EVERYTHING = GemanMcClure.from_scale(jnp.asarray(1e6))  # so wide that it is the sum of squares
equations_of = jax.jit(lambda problem, state: problem.equations(state))
cost_of = jax.jit(lambda problem, state: problem.cost(state))
equations_of_prior = jax.jit(lambda problem, state: problem.prior.normal_equations(state.cameras))
line_information = jax.jit(lambda problem, state: problem.line_information(state))
move = jax.jit(lambda state, *step: state.retract(*step))


def cameras_of(pose_model, *, with_intrinsics=False):
    rig = rig_at(TRUTH, with_covariance=False)
    states = [camera_state(c, pose_model, with_intrinsics=with_intrinsics) for c in rig.cameras]
    return stack_states(states), rig


def tracks_of(lines):
    fragments = np.where(lines.seen[:, :, None, None], lines.fragments_px, [[0.0, 0], [1, 0]])
    return FragmentTable(fragments, lines.covariance_px2, lines.seen)


def prior_of(cameras):
    """Prior of a sheet that determines the cameras' parameters with correlated errors."""
    values = jax.jit(jax.vmap(lambda camera: camera.parameters(camera)))(cameras)
    random = np.random.default_rng(4)
    root = np.eye(values.size) + 0.2 * random.normal(size=(values.size, values.size))
    scale = np.tile(np.append(np.full(3, 50.0), np.full(values.shape[1] - 3, 5.0)), len(values))
    return PosePrior(values, root @ root.T * np.outer(scale, scale), cameras)


def problem_of(lines, pose_model, loss=LOSS, *, with_intrinsics=False, off=0.0):
    """The problem, a state that is `off` from the truth (rad), and a zero step there."""
    cameras, _ = cameras_of(pose_model, with_intrinsics=with_intrinsics)
    prior = prior_of(cameras)
    problem = JointProblem(tracks_of(lines).in_three_views(), prior, loss)
    none = jnp.zeros(len(prior.information)), jnp.zeros((len(lines), 4))
    away = off * np.random.default_rng(5).normal(size=none[0].shape)
    state = move(CamerasAndLines(cameras, jnp.asarray(lines.lines_mm)), away, none[1])
    return problem, state, none


@given(vectors(3, 1.0).filter(lambda d: np.linalg.norm(d) > 0.1))
def test_normals_complete_a_basis(direction):
    basis = np.vstack([direction / np.linalg.norm(direction), complete_basis(direction)])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)


def test_the_chart_moves_anchors_across_the_line_only():
    anchors = np.array([[1.0, 2, 3], [4, 6, 3]])
    np.testing.assert_allclose(retract_line(anchors, np.zeros(4)), anchors)
    moved = np.asarray(retract_line(anchors, np.array([0.1, -0.2, 0.3, 0.4]))) - anchors
    np.testing.assert_allclose(moved @ (anchors[1] - anchors[0]), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), [np.hypot(0.1, 0.2), 0.5])


@pytest.mark.parametrize("pose_model", PoseModel)
@pytest.mark.parametrize("with_intrinsics", [False, True])
def test_a_step_of_zero_moves_nothing_and_others_are_differentiable(pose_model, with_intrinsics):
    cameras, rig = cameras_of(pose_model, with_intrinsics=with_intrinsics)
    first = jax.tree.map(lambda leaf: leaf[0], cameras)
    count = len(first.names)
    at_rest = jax.jit(lambda step: first.retract(step))(jnp.zeros(count))
    np.testing.assert_allclose(at_rest.matrix_px, rig["upper"].matrix_px, rtol=1e-12, atol=1e-9)
    rebuilt = camera_of_state(at_rest, rig["upper"])
    np.testing.assert_allclose(rebuilt.matrix_px, rig["upper"].matrix_px, rtol=1e-12, atol=1e-9)

    by_step = jax.jit(lambda: first.d_parameters_d_delta(first))()
    parameters = jax.jit(lambda step: first.retract(step).parameters(first))
    for i in range(count):
        delta = 1e-6 * np.eye(count)[i]
        difference = (parameters(delta) - parameters(-delta)) / 2e-6
        np.testing.assert_allclose(by_step[:, i], difference, rtol=1e-6, atol=1e-6)


def test_whitening_makes_the_distances_independent():
    lines, _, _ = made_tracks(0, 1)
    fragment = lines.fragments_px[0, 0]
    root = np.random.default_rng(0).normal(size=(4, 4))
    covariance = root @ root.T
    whitening = whiten_across(fragment, covariance)
    along = np.diff(fragment, axis=0)[0]
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    rows = np.kron(np.eye(2), normal)
    np.testing.assert_allclose(
        whitening @ rows @ covariance @ rows.T @ whitening.T, np.eye(2), atol=1e-9
    )


@pytest.mark.parametrize(
    ("pose_model", "with_intrinsics"),
    [pytest.param(PoseModel.AIMED, False, marks=pytest.mark.slow), (PoseModel.AIM_FREE, True)],
)
def test_cost_and_half_its_gradient_are_those_of_the_equations(pose_model, with_intrinsics):
    """The lines and the prior are away from their minimum, and some fragments are wrong."""
    lines, _, _ = made_tracks(3, COUNT, hidden=0.2, wrong=0.3)
    problem, state, none = problem_of(lines, pose_model, with_intrinsics=with_intrinsics, off=1e-3)
    cost_after = jax.value_and_grad(lambda *step: problem.cost(state.retract(*step)), (0, 1))
    cost, gradients = jax.jit(cost_after)(*none)
    equations = equations_of(problem, state)
    np.testing.assert_allclose(equations.cost, cost, rtol=1e-9)
    for gradient, expected in zip(equations.gradient, gradients, strict=True):
        assert np.abs(expected).max() > 10
        np.testing.assert_allclose(2 * gradient, expected, rtol=1e-6, atol=1e-5)


def test_where_all_agrees_the_information_is_half_the_hessian_of_the_cost():
    """The Gauss-Newton matrix is half the Hessian if all residuals are zero, the prior included."""
    lines, ends, _ = made_tracks(3, COUNT, hidden=0.2, sigma_px=0.3)
    rig = rig_at(TRUTH, with_covariance=False)
    homogeneous = np.concatenate([ends, np.ones((COUNT, 2, 1))], axis=2)
    image = np.einsum("vij,tej->tvei", rig.matrices_px, homogeneous)
    exact = LineObservations(
        lines.views, image[..., :2] / image[..., 2:], lines.covariance_px2, lines.seen, ends
    )
    problem, state, none = problem_of(exact, PoseModel.AIMED)
    assert cost_of(problem, state) < 1e-12
    flat, unflatten = ravel_pytree(none)
    hessian = jax.jit(jax.hessian(lambda step: problem.cost(state.retract(*unflatten(step)))))
    information = np.asarray(equations_of(problem, state).information.as_matrix())
    scale = np.sqrt(np.maximum(np.diag(information), 1e-9))
    normal = np.outer(scale, scale)
    np.testing.assert_allclose(information / normal, hessian(flat) / 2 / normal, atol=1e-7)


def test_the_information_is_weighted_as_the_loss_says():
    """The information equals that of dense rows of each fragment's own Jacobian."""
    lines, _, _ = made_tracks(1, COUNT, hidden=0.0, wrong=0.3)
    problem, state, none = problem_of(lines, PoseModel.RIGID, off=1e-3)
    tracks = problem.tracks
    flat, unflatten = ravel_pytree(none)

    @jax.jit
    @jax.jacfwd
    def jacobian(step):
        cameras, anchors = state.retract(*unflatten(step))
        by_view = jax.vmap(line_residual, (0, None, 0, 0))
        return jax.vmap(by_view, (None, 0, 0, 0))(cameras, anchors, *tracks[:2])

    squared = np.asarray(jax.jit(squared_distances)(state, tracks))
    assert squared.max() > 16  # weights range from nothing to one
    weight = (1 + squared / 16) ** -2
    rows = np.asarray(jacobian(flat))
    dense = np.einsum("tv,tvri,tvrj->ij", weight, rows, rows)
    head = len(none[0])
    by_step = np.asarray(equations_of_prior(problem, state).information)
    dense[:head, :head] += by_step
    information = np.asarray(equations_of(problem, state).information.as_matrix())
    np.testing.assert_allclose(information, dense, rtol=1e-8, atol=1e-8 * dense.max())


@pytest.mark.parametrize(("loss", "wrong"), [(EVERYTHING, 0.0), (LOSS, 0.3)])
def test_eliminating_the_lines_solves_the_whole_problem(loss, wrong):
    lines, _, _ = made_tracks(1, COUNT, hidden=0.0, wrong=wrong)
    problem, state, _ = problem_of(lines, PoseModel.RIGID, loss, off=1e-3)
    equations = equations_of(problem, state)
    elimination = eliminate(equations.information)
    dense = np.asarray(equations.information.as_matrix())
    head = len(elimination.reduced)
    covariance = np.linalg.inv(dense)[:head, :head]
    np.testing.assert_allclose(
        np.linalg.inv(elimination.reduced), covariance, rtol=1e-6, atol=1e-12
    )
    camera_information = (
        line_information(problem, state) + equations_of_prior(problem, state).information
    )
    np.testing.assert_allclose(np.linalg.inv(camera_information), covariance, rtol=1e-6, atol=1e-12)


def test_rounding_is_no_knowledge_of_the_gauge():
    """Without a sheet, position, orientation and scale of the rig stay undetermined."""
    lines, _, _ = made_tracks(6, 60, hidden=0.2, wrong=0.4)
    problem, state, _ = problem_of(lines, PoseModel.RIGID, off=1e-3)
    bare = eqx.tree_at(lambda p: p.prior.information, problem, jnp.zeros((18, 18)))
    information = np.asarray(line_information(bare, state))
    scale = np.sqrt(np.diag(information))
    values = np.linalg.eigvalsh(information / np.outer(scale, scale))
    assert abs(values[:7]).max() < 1e-13
    assert values[7] > 1e-5


def test_two_views_of_a_line_say_nothing_about_the_cameras():
    lines, _, _ = made_tracks(2, COUNT, hidden=1.0)
    problem, state, _ = problem_of(lines, PoseModel.RIGID)
    equations = equations_of(problem, state)
    information, gradient = equations.information, equations.gradient
    _, prior_part, prior_gradient = equations_of_prior(problem, state)
    np.testing.assert_allclose(information.head, prior_part, rtol=1e-10)
    np.testing.assert_allclose(gradient[0], prior_gradient, atol=1e-9)
    for leaf in (information.coupling, information.blocks, gradient[1]):
        np.testing.assert_array_equal(leaf, 0)


def test_the_prior_is_the_inverse_of_the_covariance_of_the_cameras_that_did_not_move():
    rig = rig_at(TRUTH, with_covariance=True)
    names = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm", "aim_x_mm", "aim_y_mm")
    choice = FreeParameters(PoseModel.AIM_FREE, False, ("upper", "right"), aim_fixed=True)
    information = prior_information(rig, names, choice)
    sigma = dict(zip(NAMES, SHEET_SIGMA, strict=True))
    for k, camera in enumerate(rig.names):
        of_aim = [FIXED_SIGMA**-2] * 2
        expected = [sigma[f"{camera}.{name}"] ** -2 for name in names[:4]] + of_aim
        camera_diagonal = np.diag(information)[6 * k : 6 * k + 6]
        np.testing.assert_allclose(camera_diagonal, 0 if camera == "left" else expected, rtol=1e-12)
    np.testing.assert_array_equal(information - np.diag(np.diag(information)), 0)


def test_a_lens_is_known_no_better_than_is_held_and_as_it_errs_with_the_pose():
    """A lens that is exact beforehand still has a sigma, so that the information is finite."""
    rig = rig_at(TRUTH, with_covariance=False)
    keys = ("upper.distance_mm", "upper.fx_px", "upper.fy_px")
    root = np.array([[2.0, 0.0, 0.0], [4.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    stated = Rig(dict(rig.items()), parameters=keys, covariance=root @ root.T)
    names = ("distance_mm", "fx_px", "fy_px")
    choice = FreeParameters(PoseModel.AIM_FREE, False, ("upper",), aim_fixed=False)
    information = prior_information(stated, names, choice)
    fixed_variance = np.diag([0.0, FIXED_SIGMA**2, FIXED_SIGMA**2])
    np.testing.assert_allclose(
        information[:3, :3], np.linalg.inv(root @ root.T + fixed_variance), rtol=1e-6
    )


def test_two_views_are_met_exactly_and_others_stay():
    lines, ends, _ = made_tracks(4, 60, hidden=0.5)
    cameras, _ = cameras_of(PoseModel.AIMED)
    tracks = tracks_of(lines)
    start = ends + np.random.default_rng(5).normal(0.0, 3.0, ends.shape)
    before = CamerasAndLines(cameras, start)
    adjusted = jax.jit(with_lines_of_two_views)(before, tracks)
    two = lines.seen.sum(axis=1) == 2
    assert 10 < two.sum() < 50
    squared = jax.jit(squared_distances)
    assert np.asarray(squared(before, tracks))[two].sum(axis=1).min() > 1.0
    np.testing.assert_allclose(np.asarray(squared(adjusted, tracks))[two], 0.0, atol=1e-8)
    anchors_mm = np.asarray(adjusted.anchors_mm)
    np.testing.assert_array_equal(anchors_mm[~two], start[~two])
    # The points of the line nearest to the anchors.
    across = np.einsum(
        "tei,ti->te", (start - anchors_mm)[two], anchors_mm[two, 1] - anchors_mm[two, 0]
    )
    np.testing.assert_allclose(across, 0.0, atol=1e-5)
    second_pass = jax.jit(with_lines_of_two_views)(adjusted, tracks).anchors_mm
    np.testing.assert_allclose(second_pass, anchors_mm, atol=1e-6)
