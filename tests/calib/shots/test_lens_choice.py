"""Which lens the shots call for."""

import numpy as np
import pytest

from tests.calib.shots.made_shots import BOARD, shots
from trinoc.calib import Systematics, calibrate_rig
from trinoc.calib.shots.lens_choice import HeldOut, choice_sentence, chosen_lens
from trinoc.errors import InputError


def errors(scale, seed, count=12):
    """Errors of the same shots: what noise makes is common to all lenses, but for a little."""
    common, own = np.random.default_rng(0), np.random.default_rng(seed)
    return HeldOut(
        {
            (0, str(k)): scale * np.abs(common.normal(size=40) * (1 + 0.05 * own.normal(size=40)))
            for k in range(count)
        }
    )


def test_the_expected_lens_stays_unless_it_is_significantly_worse():
    alike = {"brown_conrady": errors(1.001, 2), "rational": errors(1.0, 1)}
    assert chosen_lens(alike).model == "brown_conrady"
    worse = {"brown_conrady": errors(1.1, 2), "rational": errors(1.0, 1)}
    choice = chosen_lens(worse)
    assert choice.model == "rational"
    assert choice.rms_px["rational"] < choice.rms_px["brown_conrady"]
    assert "rational was chosen" in choice_sentence(choice, None)


def test_one_place_located_wrongly_decides_nothing():
    spoilt = errors(1.0, 2)
    spoilt.errors_px[0, "3"][5] = np.inf
    assert chosen_lens({"brown_conrady": spoilt, "rational": errors(1.0, 1)}).model == (
        "brown_conrady"
    )


@pytest.mark.slow
def test_auto_takes_the_true_lens_and_says_why():
    result = calibrate_rig(
        shots(cameras=("left",), count=10), BOARD, lens_model="auto", systematics=Systematics()
    )
    assert "brown_conrady was chosen" in result.notes[0]
    assert "do not ask for k4, k5, k6" in result.notes[0]
    assert abs(result.value("left.fx_px") - 800.0) < 4 * result.sigma("left.fx_px")


def test_auto_leaves_nothing_to_be_given():
    with pytest.raises(InputError, match="auto"):
        calibrate_rig(shots(count=2), BOARD, lens_model="auto", distortion=2)
