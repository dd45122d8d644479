"""A fitted lens that folds the image where no corner was seen is refused, with what to do."""

import numpy as np
import pytest

from tests.calib.shots import made_shots
from tests.calib.shots.made_shots import BOARD, SIZE_PX, lens_of, shots
from trinoc.calib.folded_lens import expect_unfolded
from trinoc.calib.result.calibration import Status
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.errors import CalibrationError
from trinoc.geometry.intrinsics import Intrinsics


def test_a_distortion_seen_in_the_middle_alone_is_not_a_result(monkeypatch):
    folds = np.array([350.0, 350.0, 319.5, 239.5, -0.27, 0.0, 0.0, 0.0, 0.0])
    monkeypatch.setitem(made_shots.LENSES, "left", folds)
    seen = shots(count=8, cameras=("left",))
    with pytest.raises(CalibrationError, match="fewer coefficients") as raised:
        calibrate_rig(seen, BOARD, distortion=1)
    assert str(raised.value).startswith('The fitted distortion of "left" folds the picture 2')
    result = calibrate_rig(seen, BOARD, distortion=1, throw=False)
    assert result.status is Status.SUSPECT
    assert (result.rig, result.halves, result.ended) == (None, None, None)
    assert str(raised.value) in result.summary()
    assert calibrate_rig(seen, BOARD, distortion=0, throw=False).rig is not None


def test_the_first_lens_that_folds_is_named():
    good = Intrinsics.of_lens(lens_of("left"), SIZE_PX)
    folds = Intrinsics(image_size_px=SIZE_PX, focal_length_px=350.0, distortion=(-0.27,))
    expect_unfolded({"left": good})
    with pytest.raises(CalibrationError, match='of "right" folds the picture 259 px'):
        expect_unfolded({"left": good, "right": folds})
