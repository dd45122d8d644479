"""Priors of sheet and aim that the images refute make the result suspect."""

import jax.numpy as jnp
import numpy as np
import pytest

from tests.calib.adjustment.made_views import SHEET, SIGMA_PX, TYPICAL, circles_px, detection
from tests.calib.simulated import LENS, TABLE_1
from trinoc.calib import CalibrationResult, Status
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.sheet_calibration import calibrate_detections
from trinoc.geometry import Pose

SIGMAS = dict(
    zip(
        BentPaper.names,
        BentPaper.sigmas(TYPICAL.print_size_sigma, TYPICAL.print_scale_sigma, TYPICAL.flatness_mm),
        strict=True,
    )
)


def calibrated(*, aim: float = 0.0, **sheet: float) -> CalibrationResult:
    """Calibration of three cameras whose sheet deviates by the given numbers of sigmas.

    aim : error of the first camera's aim, in sigmas.
    """
    shape = np.array([sheet.get(name, 0.0) * sigma for name, sigma in SIGMAS.items()])
    random, detections = np.random.default_rng(5), {}
    for name, values in TABLE_1.items():
        aim_error_mm = aim * TYPICAL.aim_sigma_mm if not detections else 0.0
        angles = np.radians(values[:3])
        pose = Pose.from_parameters(jnp.array([*angles, values[3], aim_error_mm, 0.0]))
        noise = SIGMA_PX * random.normal(size=(len(SHEET), 2))
        detections[name] = detection(circles_px(pose, np.zeros(5), shape) + noise, SIGMA_PX)
    return calibrate_detections(detections, SHEET, LENS, systematics=TYPICAL, throw=False)


@pytest.mark.parametrize(
    ("off", "message"),
    [({"XX": 7.0}, "The sheet bends by"), ({"print along X": 9.0}, "% longer along X")],
    ids=["bent", "print"],
)
def test_every_camera_over_a_sheet_that_is_refuted_is_suspect(off, message) -> None:
    result = calibrated(**off)
    assert set(result.status.values()) == {Status.SUSPECT}
    assert any(message in note for note in result.notes)
    assert all(message in fit.notes[0] for fit in result.fits.values())


def test_a_camera_that_misses_the_origin_by_far_is_suspect_alone() -> None:
    result = calibrated(aim=7.0)
    first, *others = TABLE_1
    assert result.status[first] is Status.SUSPECT
    (message,) = [note for note in result.fits[first].notes if "misses the origin" in note]
    assert "stated sigma of the aim" in message
    assert {result.status[name] for name in others} == {Status.CONVERGED}


def test_what_lies_within_what_was_said_is_no_doubt() -> None:
    result = calibrated(aim=2.0, XX=2.0, XY=-2.0, **{"print along X": 2.0})
    assert set(result.status.values()) == {Status.CONVERGED}
    assert result.notes == ()


@pytest.mark.parametrize("is_shared", [True, False])
def test_errors_far_beyond_noise_are_suspect_where_neighbouring_circles_share_them(
    is_shared: bool,
) -> None:
    """Shared errors arise if a camera shakes while its rows are read.

    Independent print errors of the same size move the poses by less than the reported sigmas.
    """
    random, detections = np.random.default_rng(6), {}
    for name, values in TABLE_1.items():
        pose = Pose.from_parameters(jnp.array([*np.radians(values[:3]), values[3], 0.0, 0.0]))
        centres_px = circles_px(pose, np.zeros(5), np.zeros(len(SIGMAS)))
        smooth = np.cos(SHEET.centres_mm[:, 1] / 20.0)
        off_px = smooth if is_shared else random.normal(size=len(centres_px))
        noise = SIGMA_PX * random.normal(size=centres_px.shape)
        noise[:, 0] += 20 * SIGMA_PX * off_px
        detections[name] = detection(centres_px + noise, SIGMA_PX)
    result = calibrate_detections(detections, SHEET, LENS, systematics=TYPICAL, throw=False)
    for name in TABLE_1:
        assert any("neighbouring" in note for note in result.fits[name].notes) is is_shared
        assert (result.status[name] is Status.SUSPECT) is is_shared
