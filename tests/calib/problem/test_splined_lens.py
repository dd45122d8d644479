"""Calibration of a lens that no polynomial describes, with a spline correction."""

import pickle
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.calib import simulated_lens
from tests.calib.made_shots import BOARD, SIZE_PX, lens_of
from tests.calib.problem.equations import assert_equations_are_those_of_the_cost
from trinoc.calib import Detection
from trinoc.calib.advice.halves import covariance_of_difference
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.lens_correction import (
    add_splines,
    assess_corrections,
    measure_corrections,
    with_correction,
)
from trinoc.calib.problem.problem import FreeLensParameters, lens_of_index, with_priors
from trinoc.calib.problem.robust_fit import RobustFit
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.views import BoardObservation
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.sentences import lens_corrected
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import InputError
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import spline_lens
from trinoc.geometry.lenses.splined import AbstractSplinedLens, SplinedBrownConrady
from trinoc.geometry.rig import Rig
from trinoc.geometry.rotation import rotation_from_vector
from trinoc.io import FORMATS
from trinoc.io.rig_json import load_rig
from trinoc.io.saving import save

SIGMA_PX = 0.05
TOP_PX, WHERE_PX, WIDTH_PX = np.array([0.6, -0.4]), np.array([450.0, 170.0]), 75.0
unproject = jax.jit(jax.vmap(lambda lens, uv_px: lens.unproject(uv_px), (None, 0)))
project = jax.jit(jax.vmap(lambda lens, ray: lens.project_ray(ray), (None, 0)))


def bumped_pixels(rays):
    """Pixels of a lens of Brown and Conrady with a bump."""
    uv_px = np.asarray(project(lens_of("left"), rays))
    away = np.sum((uv_px - WHERE_PX) ** 2, axis=1) / WIDTH_PX**2
    return uv_px + np.exp(-0.5 * away)[:, None] * TOP_PX


def poses(count, seed=3):
    """Random poses of the board near the camera, all over its image."""
    random = np.random.default_rng(seed)
    board_poses = []
    for _ in range(count):
        about, tilt = random.uniform(0, 2 * np.pi), np.radians(random.uniform(15, 40))
        turn = np.asarray(rotation_from_vector(tilt * np.array([np.cos(about), np.sin(about), 0])))
        depth = random.uniform(250.0, 400.0)
        position_mm = depth * np.array([*random.uniform((-0.22, -0.15), (0.22, 0.15)), 1.0])
        board_poses.append(np.column_stack([turn @ np.diag([1.0, -1.0, -1.0]), position_mm]))
    return np.stack(board_poses)


def detections(boards, seed=0):
    random, made = np.random.default_rng(seed), []
    for board in boards:
        uv_px = bumped_pixels(BOARD.centres_mm @ board[:, :2].T + board[:, 3])
        inside = ((uv_px > 2) & (uv_px < np.array(SIZE_PX) - 3)).all(axis=1)
        count = int(inside.sum())
        made.append(
            Detection(
                circle_index=np.flatnonzero(inside),
                centres_px=uv_px[inside] + random.normal(0, SIGMA_PX, (count, 2)),
                covariance_px2=np.broadcast_to(SIGMA_PX**2 * np.eye(2), (count, 2, 2)).copy(),
                shape_px2=np.full((count, 2, 2), np.nan),
                lines_px=np.full((2, 3), np.nan),
                image_size_px=SIZE_PX,
            )
        )
    return made


def core_problem(count, seed=0):
    """Problem of a lens without the bump, at the truth."""
    boards = poses(count)
    views = [
        BoardObservation(0, shot, each, np.ones(len(each), dtype=bool))
        for shot, each in enumerate(detections(boards, seed))
    ]
    return start_problem(
        views, BOARD, [lens_of("left")], np.eye(3, 4)[None], boards, [SIZE_PX],
        FreeLensParameters(np.zeros(1, dtype=int), np.ones((1, 9), dtype=bool)), Systematics(),
    )  # fmt: skip


def test_the_equations_are_those_of_the_cost_with_control_points_and_their_prior():
    here = add_splines(core_problem(3), [SIZE_PX])
    prior = 9.0 * SplinedBrownConrady.correction_information()[None]
    assert_equations_are_those_of_the_cost(with_priors(here, lens_information=prior))
    lens = here.state.lenses
    fixed_rows = [lens.parameter_names.index(name) for name in lens.never_fitted]
    assert not np.asarray(here.free)[fixed_rows].any()


def test_control_points_are_told_as_far_as_the_shots_know_more_than_the_prior():
    here = add_splines(core_problem(3), [SIZE_PX])
    unit, sigma_px = SplinedBrownConrady.correction_information(), np.array([0.5])
    here = with_priors(here, lens_information=unit[None] / sigma_px**2)
    values = np.array(here.state.lenses.coefficients)
    count = int(np.count_nonzero(np.diag(unit) > 0))
    values[:, -count:] = 0.1 * np.random.default_rng(0).normal(size=count)
    here = here._replace(state=eqx.tree_at(lambda s: s.lenses.coefficients, here.state, values))
    squares, effective_counts = assess_corrections(here, sigma_px)
    information = compute_information(here)
    covariance = np.nan_to_num(information.observability.covariance)
    control_rows = np.flatnonzero(np.diag(information.prior) > 0)
    control_rows = control_rows[
        control_rows < np.searchsorted(information.free, here.slices.lenses.stop)
    ]
    # The trace of what all shots say times the covariance, over the control points.
    shots_information = information.shot_information.sum(axis=0)[
        np.ix_(information.free, information.free)
    ]
    assert effective_counts[0] == pytest.approx(
        np.trace((covariance @ shots_information)[np.ix_(control_rows, control_rows)]), rel=1e-5
    )
    assert 5 < effective_counts[0] < 0.9 * len(control_rows)
    parameters = lens_of_index(here, 0).parameters
    assert squares[0] == pytest.approx(parameters @ unit @ parameters)


def test_two_fits_under_one_prior_differ_as_their_covariances_say():
    """The covariance of the difference equals the scatter of 4,000 simulated linear fits.

    `factor` is the variance of the noise.
    """
    random, factor = np.random.default_rng(0), 2.0
    rows = random.normal(size=(2, 5, 4))
    prior = np.diag([4.0, 1.0, 0.0, 0.0])
    truth = random.normal(size=(4000, 4)) / np.array([2.0, 1.0, 1.0, 1.0])
    ends, covariances = [], []
    for design in rows:
        covariance = np.linalg.inv(design.T @ design + prior)
        observations = truth @ design.T + np.sqrt(factor) * random.normal(size=(4000, 5))
        ends.append(observations @ design @ covariance)
        covariances.append(covariance)
    first, second = covariances
    expected = covariance_of_difference(first, second, prior, factor)
    scatter = np.cov((ends[0] - ends[1]).T)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        scatter / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.1
    )


def field_px():
    u, v = np.meshgrid(np.linspace(20, 620, 13), np.linspace(20, 460, 10))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def field_error(lens, covariance):
    """Errors (n, 2) over the field in px and their reported covariance, without a camera turn."""
    rays = unproject(lens_of("left"), field_px())

    @jax.jit
    @partial(jax.jacfwd, has_aux=True)
    def by_parameters(step):
        turned = rays @ rotation_from_vector(step[-3:]).T
        moved = lens.with_parameters(lens.parameters + step[:-3])
        uv_px = jax.vmap(moved.project_ray)(turned).ravel()
        return uv_px, uv_px

    by_step, uv_px = by_parameters(jnp.zeros(len(lens.parameters) + 3))
    by_lens, by_turn = np.asarray(by_step)[:, :-3], np.asarray(by_step)[:, -3:]
    without_turn = np.eye(len(by_turn)) - by_turn @ np.linalg.pinv(by_turn)
    by_lens = without_turn @ by_lens
    return without_turn @ (uv_px - bumped_pixels(rays).ravel()), by_lens @ covariance @ by_lens.T


def corrected(seed):
    """The problem at the end of a splined fit, its lens, and errors and covariance of the field."""
    core = RobustFit(core_problem(24, seed), True, [], 0.0, 0)
    end = with_correction(core, [SIZE_PX]).problem
    information, scale = compute_information(end), np.asarray(end.parametrization.lens_scale)[0]
    rows = np.ix_(information.free[:249], information.free[:249])
    covariance = np.zeros((len(scale), len(scale)))
    covariance[rows] = information.observability.covariance[:249, :249]
    lens = lens_of_index(end, 0)
    assert isinstance(lens, AbstractSplinedLens)
    return end, lens, *field_error(lens, covariance * np.outer(scale, scale))


@pytest.mark.slow
def test_a_bump_is_found_as_well_as_is_claimed():
    """The error over six fits has the reported size.

    The error of one fit is smooth over the field, so that its ratio to the reported one varies from
    .45 to 1.33.
    """
    fits = [corrected(seed) for seed in range(6)]
    ratios = [np.mean(error**2) / np.mean(np.diag(reported)) for _, _, error, reported in fits]
    assert 0.8 < np.sqrt(np.mean(ratios)) < 1.25
    end, lens, error, _ = fits[0]
    is_near_bump = np.linalg.norm(field_px() - WHERE_PX, axis=1) < 1.5 * WIDTH_PX
    assert np.sqrt(np.mean(error.reshape(-1, 2)[is_near_bump] ** 2)) < SIGMA_PX
    moved_px = np.asarray(project(lens, unproject(lens.core, WHERE_PX[None]))) - WHERE_PX[None]
    assert np.abs(moved_px).max() > 0.3
    assert end.sigma_factor[0] == pytest.approx(1.0, abs=0.1)
    (correction,) = measure_corrections(end)
    sentence = lens_corrected(correction, "left")
    assert sentence.startswith('The lens of "left" has a spline correction of ')


@pytest.mark.slow
def test_a_rig_is_calibrated_with_splines_where_its_shots_ask_for_them(tmp_path):
    shots = {"left": detections(poses(24))}
    result = calibrate_rig(shots, BOARD, lens_model="auto", systematics=Systematics())
    assert " and need a correction by splines" in result.notes[0]
    assert "splined_brown_conrady was chosen" in result.notes[0]
    assert result.halves is not None
    assert result.cross_validation is not None
    assert result.has_rig
    assert result.halves.ratio == pytest.approx(1.0, abs=0.3)
    assert result.cross_validation.own_px["left"] < 1.3 * np.sqrt(2) * SIGMA_PX
    assert "du_3_4" not in result.summary()
    assert result.sigma("left.du_3_4") > 0.0
    save(result.rig, tmp_path / "rig.json")
    back = load_rig(tmp_path / "rig.json")
    np.testing.assert_allclose(back.covariance, result.rig.covariance, rtol=1e-12)


@pytest.mark.slow
def test_one_camera_is_corrected_from_its_circles():
    """The correction reduces the residuals of the circles to less than a fifth."""
    middle, width = np.array([330.0, 180.0]), 60.0
    bent = []
    for each in simulated_lens.detections(simulated_lens.good_poses(0, 12), seed=1):
        away = np.sum((each.centres_px - middle) ** 2, axis=1) / width**2
        moved = each.centres_px + np.exp(-0.5 * away)[:, None] * np.array([0.3, -0.2])
        bent.append(eqx.tree_at(lambda detection: detection.centres_px, each, moved))
    sheet = simulated_lens.SHEET
    plain = calibrate_intrinsics(bent, sheet)
    result = calibrate_intrinsics(bent, sheet, lens_model="splined")
    assert result.has_rig
    assert result.lens.distortion_model == "splined_brown_conrady"
    assert result.rms_px() < 0.2 * plain.rms_px()
    assert 0.8 < result.reduced_chi_square < 1.2
    assert result.fits["camera"].rank == len(simulated_lens.fitted_names(result)) == 249
    assert "du_3_4" not in result.summary()
    assert any("in addition to the brown_conrady model" in note for note in result.notes)


def test_a_rig_is_pickled_and_other_tools_files_say_that_they_cannot_hold_it(tmp_path):
    lens = Intrinsics.of_lens(spline_lens(lens_of("left"), SIZE_PX), SIZE_PX)
    values = np.array(lens.lens.parameters)
    values[-5:] = 0.5
    lens = Intrinsics.of_lens(lens.lens.with_parameters(values), SIZE_PX)
    rig = Rig({"left": Camera(lens, Pose(poses(1)[0]))})
    save(rig, tmp_path / "rig.json")
    for back in (load_rig(tmp_path / "rig.json"), pickle.loads(pickle.dumps(rig))):
        np.testing.assert_array_equal(back["left"].intrinsics.lens.parameters, values)
    for name in ("colmap", "mrcal", "opencv"):
        with pytest.raises(
            InputError, match=r"splined_brown_conrady, which .* cannot contain splines"
        ):
            FORMATS[name].save(rig, tmp_path / "out.yml")


def test_names_that_choose_leave_nothing_to_be_given():
    with pytest.raises(InputError, match='lens_model is "splined"'):
        calibrate_rig({"left": detections(poses(2))}, BOARD, lens_model="splined", distortion=2)
