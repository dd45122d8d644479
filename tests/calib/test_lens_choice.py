"""Choice of the lens model by the shots."""

import numpy as np
import pytest

from tests.calib.made_shots import BOARD, shots
from trinoc.calib.lens_selection import choice_sentence, choose_lens
from trinoc.calib.problem.information import Information
from trinoc.calib.problem.rao_test import FixedScore, rao_test, score_of_fixed
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import InputError


def errors(scale, seed, count=12):
    """Errors of the same shots with several lenses, which share most of their noise."""
    shared_random, lens_random = np.random.default_rng(0), np.random.default_rng(seed)
    return {
        (0, str(k)): scale
        * np.abs(shared_random.normal(size=40) * (1 + 0.05 * lens_random.normal(size=40)))
        for k in range(count)
    }


def test_the_expected_lens_stays_unless_it_is_significantly_worse():
    alike = {"brown_conrady": errors(1.001, 2), "rational": errors(1.0, 1)}
    assert choose_lens(alike).model == "brown_conrady"
    worse = {"brown_conrady": errors(1.1, 2), "rational": errors(1.0, 1)}
    choice = choose_lens(worse)
    assert choice.model == "rational"
    assert choice.rms_px["rational"] < choice.rms_px["brown_conrady"]
    assert "rational was chosen" in choice_sentence(choice, None)


def test_one_place_located_wrongly_decides_nothing():
    spoilt = errors(1.0, 2)
    spoilt[0, "3"][5] = np.inf
    assert choose_lens({"brown_conrady": spoilt, "rational": errors(1.0, 1)}).model == (
        "brown_conrady"
    )


@pytest.mark.slow
def test_auto_takes_the_true_lens_and_says_why():
    result = calibrate_rig(
        shots(cameras=("left",), count=10), BOARD, lens_model="auto", systematics=Systematics()
    )
    assert "brown_conrady was chosen" in result.notes[0]
    assert "do not need k4, k5, k6" in result.notes[0]
    assert abs(result.value("left.fx_px") - 800.0) < 4 * result.sigma("left.fx_px")
    assert result.cross_validation is not None
    assert result.cross_validation.across_px == {}


def test_auto_leaves_nothing_to_be_given():
    with pytest.raises(InputError, match="auto"):
        calibrate_rig(shots(count=2), BOARD, lens_model="auto", distortion=2)


def information(random, share):
    """Information of 40 shots with noise about seven parameters.

    Parameters 5 to 7 act as combinations of the first four. Only `share` of the variance of 5 and 6
    is their own, and none of 7.
    """
    free, independent = random.normal(size=(2, 40, 4, 4)), random.normal(size=(40, 4, 3))
    more = free[0] @ np.arange(12.0).reshape(4, 3) + np.sqrt(share) * independent
    more[..., 2] = free[0] @ np.ones(4)
    rows = np.concatenate([free[0], more], axis=2)
    noise = random.normal(size=(40, 4))
    return Information(
        np.swapaxes(rows, 1, 2) @ rows, np.einsum("sji,sj->si", rows, noise), np.zeros((40, 6, 7)),
        np.zeros((40, 6, 6)), np.arange(7), np.zeros((7, 7)), 7,
    )  # fmt: skip


@pytest.mark.parametrize("share", [1.0, 1e-5])
def test_without_need_of_more_parameters_the_rao_test_gives_any_chance_alike(share):
    random = np.random.default_rng(0)
    tests = [rao_test(information(random, share), np.arange(7) >= 4) for _ in range(500)]
    assert {test.freedom for test in tests} == {2}
    chances = np.sort([test.p_value for test in tests])
    # Kolmogorov and Smirnov's distance, which exceeds this once in a hundred times.
    assert np.abs(chances - (np.arange(500) + 0.5) / 500).max() < 1.63 / np.sqrt(500)


def test_the_rao_test_sees_what_was_held_wrongly():
    """An effect of other parameters does not count, and an offset of five sigmas does."""
    random = np.random.default_rng(1)
    here, is_fixed = information(random, 1.0), np.arange(7) >= 4
    noise = rao_test(here, is_fixed).chi_square
    total = here.shot_information.sum(axis=0)
    pulled = here._replace(gradients=here.gradients + (total @ [3.0, -2, 5, 1, 0, 0, 0]) / 40)
    assert rao_test(pulled, is_fixed).chi_square == pytest.approx(noise)
    remaining = total[4, 4] - total[4, :4] @ np.linalg.solve(total[:4, :4], total[:4, 4])
    off = np.eye(7)[4] * 5 / np.sqrt(remaining)
    off = here._replace(gradients=here.gradients + total @ off / 40)
    assert rao_test(off, is_fixed).p_value < 1e-3


def test_what_is_freed_first_to_first_order_was_fitted():
    here = information(np.random.default_rng(2), 1.0)
    score = FixedScore(*score_of_fixed(here, np.arange(7) >= 4), 160.0, 156.0, False)
    score_after_freeing, fitted = score.with_freed([0]), rao_test(here, np.arange(7) == 5)
    assert score_after_freeing.test([1]).chi_square == pytest.approx(fitted.chi_square)
    np.testing.assert_allclose(score_after_freeing.test([1]).step, fitted.step)
    np.testing.assert_allclose(score_after_freeing.test([1]).covariance, fitted.covariance)
    assert score_after_freeing.test([0]).freedom == 0
    assert score_after_freeing.squared == 160.0 - score.test([0]).chi_square
    assert score_after_freeing.freedom == 155.0


def test_where_the_shots_cannot_pull_chance_is_all():
    here = information(np.random.default_rng(0), 1.0)
    test = rao_test(here, np.arange(7) == 6)
    assert (test.chi_square, test.freedom, test.p_value) == (0.0, 0, 1.0)
    assert not test.step.any()
    assert not test.covariance.any()
