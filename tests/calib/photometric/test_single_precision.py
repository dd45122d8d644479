"""Effect of single precision on the fit to grey levels, as docs/limits.md states it."""

from collections.abc import Iterator

import jax
import numpy as np
import pytest

from trinoc.calib.photometric import scene
from trinoc.calib.problem.solver import CONVERGED_GAIN
from trinoc.calib.sheet_calibration import calibrate
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.io import demo_images, demo_pattern
from trinoc.numerics.programs import forget_programs, set_program_store
from trinoc.synth import table1_lens


@pytest.fixture
def compiled_as_for_users() -> Iterator[None]:
    """Compile with the optimizations that other tests switch off: they round ten times as much."""
    store = set_program_store(None)
    forget_programs()
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", True)
    forget_programs()
    set_program_store(store)


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_as_for_users")
def test_double_precision_moves_no_parameter_beyond_the_stopping_rule(monkeypatch) -> None:
    inputs = demo_images("sheet"), demo_pattern(), table1_lens()
    single = calibrate(*inputs, systematics=Systematics())
    pad_group = scene.pad_group

    def in_double_precision(part, image, lens, pattern, capacity, dtype, shift_px):
        assert dtype is np.float32
        return pad_group(part, image, lens, pattern, capacity, np.float64, shift_px)

    monkeypatch.setattr(scene, "pad_group", in_double_precision)
    double = calibrate(*inputs, systematics=Systematics())
    assert {fit.method for fit in double.fits.values()} == {"pixels"}
    sigma = np.sqrt(np.diag(double.covariance))
    # A fit stops where the chi-square gains no more than this, the square of a share of a sigma.
    stops_apart = 2.0 * np.sqrt(CONVERGED_GAIN)
    np.testing.assert_array_less(np.abs(single.values - double.values), stops_apart * sigma)
    # Two digits of a sigma are shown, so that a thousandth of it is nothing.
    np.testing.assert_allclose(np.sqrt(np.diag(single.covariance)), sigma, rtol=1e-3)
