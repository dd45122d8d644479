"""Displaced points of the board are estimated if the shots determine them, and only then."""

import numpy as np
import pytest

from tests.calib.made_shots import BOARD, LENSES, lens_of, shots
from trinoc.calib.problem.outcome import ShotScatter
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.uncertainty.systematics import Systematics

FLAT_ENOUGH = Systematics(print_scale_sigma=(1e-4, 1e-4), flatness_mm=0.05)


def fitted(aside_mm, systematics=FLAT_ENOUGH):
    detections = shots(count=8, aside_mm=aside_mm)
    return calibrate_rig(detections, BOARD, systematics=systematics, distortion=4)


@pytest.fixture(scope="module")
def wavy():
    random = np.random.default_rng(5)
    return random.normal(0.0, [0.04, 0.04, 0.3], (len(BOARD), 3))


@pytest.fixture(scope="module")
def calibration(wavy):
    return fitted(wavy)


def lens_errors(result):
    """Errors of all lenses in reported sigmas."""
    return np.concatenate(
        [
            (result.value(name) - true) / result.sigma(name)
            for camera, values in LENSES.items()
            for name, true in zip(
                [f"{camera}.{each}" for each in lens_of(camera).parameter_names], values
            )
            if result.sigma(name) > 0
        ],
        axis=None,
    )


@pytest.mark.slow
def test_a_wavy_board_is_found_with_the_rig(calibration, wavy):
    assert calibration.place_shifts_mm.shape == wavy.shape
    # The rest is noise, and shapes that a motion or a scale of the board replaces.
    basis = np.column_stack([np.ones(len(BOARD)), BOARD.centres_mm])
    rise = wavy[:, 2] - calibration.place_shifts_mm[:, 2]
    bowl = BOARD.centres_mm**2
    basis = np.column_stack([basis, bowl])
    rise = rise - basis @ np.linalg.lstsq(basis, rise)[0]
    assert np.sqrt(np.mean(rise**2)) < 0.3 * 0.3
    assert any("points deviate from the drawing" in note for note in calibration.notes)
    errors = lens_errors(calibration)
    assert 0.5 < np.sqrt(np.mean(errors**2)) < 1.6
    assert calibration.rms_px() < 0.08


@pytest.mark.slow
def test_a_flat_board_stays_as_drawn():
    assert fitted(np.zeros((len(BOARD), 3))).place_shifts_mm.shape == (0, 3)


@pytest.mark.slow
def test_a_board_that_is_said_to_be_exact_stays_as_drawn(wavy):
    result = fitted(wavy, Systematics())
    assert len(result.place_shifts_mm) == 0
    # Its lenses bend to follow it: the sigmas grow, but not to what a wavy board does.
    assert max(fit.sigma_factor for fit in result.fits.values()) > 0


def test_scatter_that_chance_makes_enlarges_nothing():
    assert ShotScatter(1.2, 0.1).variance_factor == 1.0
    assert ShotScatter(2.0, 0.1).variance_factor == 2.0
