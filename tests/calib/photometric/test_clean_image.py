"""An image of bare ink on paper loses no pixel to the gate against covers."""

import pytest

from trinoc.calib.sheet_calibration import calibrate
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.io import demo_images, demo_pattern

LENS = Intrinsics(focal_length_mm=16, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(512, 480))


@pytest.mark.slow
@pytest.mark.parametrize("view", ["upper", "left"])
def test_the_fit_has_settled_before_it_judges_pixels(view):
    result = calibrate(
        {view: demo_images("sheet")[view]}, demo_pattern(), LENS, systematics=Systematics()
    )
    quality = result.fits[view].image
    assert quality is not None
    assert quality.pixels_cut == 0
    assert result.fits[view].notes == ()
