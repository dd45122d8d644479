"""A lens of a rig with a given covariance is an unknown with a prior."""

import numpy as np
import pytest
from scipy.stats import chi2

from tests.calib.made_shots import BOARD, LENSES, SIZE_PX, lens_of, shots
from trinoc.calib.problem.coefficients import free_of_lenses
from trinoc.calib.problem.problem import lens_of_index, with_lens_free, with_wider_lenses
from trinoc.calib.problem.variables import evaluate_prior
from trinoc.calib.result.calibration import Status
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.lenses.skewed import skew_lens

TWO = ("left", "right")
KNOWN = {name: Intrinsics.of_lens(lens_of(name), SIZE_PX) for name in TWO}
# Sigmas of fx, fy, cx, cy, k1, k2, p1, p2, k3: about those by four shots; k3 is exact.
SIGMA = np.array([1.5, 1.5, 1.0, 1.0, 0.01, 0.03, 5e-4, 5e-4, 0.0])
CORRELATION = np.eye(9)
CORRELATION[0, 1] = CORRELATION[1, 0] = 0.9
COVARIANCE = CORRELATION * np.outer(SIGMA, SIGMA)


def known_to(covariance: np.ndarray, *names: str) -> Systematics:
    return Systematics(lens_covariance=dict.fromkeys(names, covariance))


def test_a_lens_known_well_is_as_one_that_is_exact():
    detections = shots(count=4, cameras=TWO)
    exact = calibrate_rig(detections, BOARD, lens=KNOWN, systematics=Systematics(), world="left")
    tight = calibrate_rig(
        detections, BOARD, lens=KNOWN, systematics=known_to(1e-10 * COVARIANCE, *TWO), world="left"
    )
    rows = [tight.parameters.index(name) for name in exact.parameters]
    sigma, fitted = np.sqrt(np.diag(exact.covariance)), np.diag(exact.covariance) > 0
    assert np.all(np.abs(tight.values[rows] - exact.values)[fitted] < 1e-2 * sigma[fitted])
    now = np.sqrt(np.diag(tight.covariance))[rows]
    assert now[fitted] == pytest.approx(sigma[fitted], rel=2e-2)


def test_lens_and_pose_are_as_far_off_as_is_claimed():
    """The normalised errors are chi-square over draws of the lens from its prior, and of noise."""
    squared, freedom = 0.0, 0
    for seed in range(12):
        random = np.random.default_rng(seed)
        given_values = LENSES["left"] + random.multivariate_normal(np.zeros(9), COVARIANCE)
        lens = Intrinsics.of_lens(BrownConrady.from_parameters(given_values), SIZE_PX)
        result = calibrate_rig(
            shots(seed=seed, count=4, cameras=TWO),
            BOARD,
            lens=KNOWN | {"left": lens},
            systematics=known_to(COVARIANCE, "left"),
            world="left",
        )
        assert result.has_rig
        rows = [result.parameters.index(f"left.{name}") for name in lens_of("left").parameter_names]
        off, free = result.values[rows] - LENSES["left"], SIGMA > 0
        assert off[~free] == 0
        covariance = result.covariance[np.ix_(rows, rows)][np.ix_(free, free)]
        assert np.all(np.sqrt(np.diag(covariance)) < SIGMA[free])
        squared += off[free] @ np.linalg.solve(covariance, off[free])
        freedom += int(free.sum())
    low, high = chi2.ppf([0.001, 0.999], freedom)
    assert low < squared < high


def check_left_is_strained(given_lens: Intrinsics, covariance: np.ndarray) -> None:
    result = calibrate_rig(
        shots(count=4, cameras=TWO),
        BOARD,
        lens=KNOWN | {"left": given_lens},
        systematics=known_to(covariance, "left"),
    )
    assert result.overall_status is Status.SUSPECT
    assert result.notes[0].startswith('Lens of "left": the images contradict the given lens')


def test_a_lens_that_the_shots_refute_is_named():
    given_values = LENSES["left"] + 8 * np.array([0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0])
    lens = Intrinsics.of_lens(BrownConrady.from_parameters(given_values), SIZE_PX)
    check_left_is_strained(lens, COVARIANCE)


def test_a_lens_without_distortion_is_strained_by_what_the_shots_show_of_it(monkeypatch):
    """Only k1 is uncertain, and its prior has the mean 0."""
    true = np.array([*LENSES["left"][:4], -0.2, 0.0, 0.0, 0.0, 0.0])
    monkeypatch.setitem(LENSES, "left", true)
    given_lens = Intrinsics(
        focal_length_px=true[:2], principal_point_px=true[2:4], image_size_px=SIZE_PX
    )
    covariance = np.zeros((5, 5))
    covariance[4, 4] = SIGMA[4] ** 2
    check_left_is_strained(given_lens, covariance)


def test_what_is_known_of_a_lens_stays_with_more_parameters_and_with_fewer_free():
    result = calibrate_rig(
        shots(count=4, cameras=TWO), BOARD, lens=KNOWN, systematics=known_to(COVARIANCE, *TWO)
    )
    assert result.solved_problem is not None
    problem = result.solved_problem.problem
    before = evaluate_prior(problem.state, problem.parametrization).cost
    skewed = [skew_lens(lens_of_index(problem, number)) for number in range(2)]
    wider = with_wider_lenses(problem, skewed, [SIZE_PX, SIZE_PX])
    assert evaluate_prior(wider.state, wider.parametrization).cost == pytest.approx(before)
    free = free_of_lenses(problem)
    free[:, -1] = free[:, 5] = False
    fixed_lenses = with_lens_free(problem, free).state.lenses
    assert np.array_equal(fixed_lenses.coefficients, problem.state.lenses.coefficients)


@pytest.mark.parametrize("stated", [COVARIANCE, {"right": COVARIANCE}])
def test_the_covariance_of_a_lens_that_is_not_given_is_refused(stated):
    with pytest.raises(InputError, match=r'"right", but `lens` has no lens'):
        calibrate_rig(
            shots(count=4, cameras=TWO),
            BOARD,
            lens={"left": KNOWN["left"]},
            systematics=Systematics(lens_covariance=stated),
        )
