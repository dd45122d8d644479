"""Many frames at once give what each gives alone, and one bad frame spoils no other."""

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
from trinoc.calib import Status, calibrate_batch, calibrate_detections

SHEET = reference_sheet()


def test_frames_are_independent() -> None:
    frames = [
        {
            name: simulated_detection(camera_of(values), SHEET, seed=10 * k + j)
            for j, (name, values) in enumerate(TABLE_1.items())
        }
        for k in range(5)
    ]
    frames[1]["right"] = simulated_detection(
        camera_of(TABLE_1["right"]), SHEET, seed=0, circles=np.array([4])
    )
    del frames[3]["left"]
    frames[4]["upper"].centres_px[3] += 20.0
    batch = calibrate_batch(frames, SHEET, LENS, systematics=EXACT)
    assert batch.names == tuple(TABLE_1)
    assert batch.good.sum() == 13
    assert batch.status[1]["right"] is Status.RANK_DEFICIENT
    assert batch.status[3]["left"] is Status.NOT_DETECTED
    assert "free" in batch.failures[1]["right"]
    assert np.isnan(batch.values[1, 1]).all()
    for k in (0, 4):
        alone = calibrate_detections(frames[k], SHEET, LENS, systematics=EXACT)
        sigma = np.sqrt(np.diag(alone.covariance))
        # The batch takes the circles alone, by another form of the same residuals.
        np.testing.assert_allclose((batch.values[k].ravel() - alone.values) / sigma, 0, atol=0.1)
        np.testing.assert_allclose(
            np.sqrt(np.diagonal(batch.covariance[k], axis1=1, axis2=2)).ravel(), sigma, rtol=0.02
        )


@pytest.mark.slow
def test_frames_have_the_errors_of_each_calibration_alone() -> None:
    frames = [
        {
            name: simulated_detection(camera_of(TABLE_1[name]), SHEET, seed=10 * k + j)
            for j, name in enumerate(names)
        }
        for k, names in enumerate([("left", "upper", "right"), ("left", "right"), ()])
    ]
    batch = calibrate_batch(frames, SHEET, LENS)
    for k, frame in enumerate(frames[:2]):
        alone = calibrate_detections(frame, SHEET, LENS)
        for name in frame:
            v = batch.names.index(name)
            rows = [alone.parameters.index(f"{name}.{key}") for key in batch.parameters]
            np.testing.assert_array_equal(batch.values[k, v], alone.values[rows])
            np.testing.assert_array_equal(
                batch.covariance[k, v], alone.covariance[np.ix_(rows, rows)]
            )
    assert batch.good.tolist() == [[True, True, True], [True, False, True], [False] * 3]
    assert set(batch.status[2].values()) == {Status.NOT_DETECTED}
