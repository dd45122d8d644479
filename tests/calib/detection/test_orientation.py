"""The labelling of a sheet with rotational symmetry is not chosen by chance."""

import numpy as np
import pytest

from tests.calib.simulated import (
    EXACT,
    LENS,
    TABLE_1,
    camera_of,
    reference_sheet,
    simulated_detection,
)
from trinoc.calib import Detection, Status, calibrate_detections
from trinoc.errors import CalibrationError
from trinoc.geometry.rig import Rig

SHEET = reference_sheet()
# Row by row from the top left: the grid turned by 90, 180 and 270 degrees.
TURNS = np.stack([np.rot90(np.arange(25).reshape(5, 5), k).ravel() for k in range(4)])


def open_detection(name: str, turn: int, seed: int) -> Detection:
    """Detection with the labelling that is `turn` quarter turns off the true one."""
    camera = camera_of(TABLE_1[name])
    detection = simulated_detection(camera, SHEET, seed=seed)
    choices = np.roll(TURNS, -turn, axis=0)
    return Detection(
        circle_index=choices[0],
        centres_px=detection.centres_px,
        covariance_px2=detection.covariance_px2,
        shape_px2=detection.shape_px2,
        lines_px=detection.lines_px[::-1] if turn % 2 else detection.lines_px,
        image_size_px=detection.image_size_px,
        ambiguity=choices[1:],
    )


def detections(turns: tuple[int, int, int]) -> dict[str, Detection]:
    return {
        name: open_detection(name, turn, seed)
        for seed, (name, turn) in enumerate(zip(TABLE_1, turns, strict=True))
    }


def test_nobody_chooses_unless_told_by_what() -> None:
    with pytest.raises(CalibrationError, match="rotated by 90 degrees") as raised:
        calibrate_detections(detections((0, 0, 0)), SHEET, LENS, systematics=EXACT)
    assert set(raised.value.failures) == set(TABLE_1)
    mixed = detections((0, 0, 0)) | {
        "left": simulated_detection(camera_of(TABLE_1["left"]), SHEET, seed=2)
    }
    result = calibrate_detections(mixed, SHEET, LENS, throw=False, systematics=EXACT)
    assert result.rig.names == ("left",)
    assert result.status["upper"] is Status.AMBIGUOUS
    assert 'orientation="upright"' in result.summary()


@pytest.mark.slow
def test_upright_takes_what_the_detector_put_first() -> None:
    result = calibrate_detections(
        detections((0, 0, 0)), SHEET, LENS, orientation="upright", systematics=EXACT
    )
    estimate = np.reshape(result.values, (3, 4))
    np.testing.assert_allclose(estimate, list(TABLE_1.values()), atol=0.05)


@pytest.mark.parametrize("turns", [(0, 1, 2), (3, 2, 1)])
def test_an_earlier_rig_tells_whichever_labelling_came_first(turns: tuple[int, int, int]) -> None:
    moved = {name: (pan + 1, tilt, swing, far) for name, (pan, tilt, swing, far) in TABLE_1.items()}
    earlier = Rig({name: camera_of(values) for name, values in moved.items()})
    result = calibrate_detections(
        detections(turns), SHEET, LENS, orientation=earlier, systematics=EXACT
    )
    estimate = np.reshape(result.values, (3, 4))
    np.testing.assert_allclose(estimate, list(TABLE_1.values()), atol=0.05)


def test_an_earlier_rig_that_does_not_tell_is_no_answer() -> None:
    pan, tilt, swing, far = TABLE_1["upper"]
    between = Rig({"upper": camera_of((pan + 45, tilt, swing, far))})
    result = calibrate_detections(
        detections((0, 0, 0))
        | {"left": simulated_detection(camera_of(TABLE_1["left"]), SHEET, seed=2)},
        SHEET,
        LENS,
        orientation=between,
        throw=False,
        systematics=EXACT,
    )
    assert result.rig.names == ("left",)
    assert "does not determine the orientation" in result.failures["upper"]
    assert "has no camera" in result.failures["right"]
