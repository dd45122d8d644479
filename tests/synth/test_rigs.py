"""Synthetic rigs: table 1 of the paper, and random rigs."""

import numpy as np
import pytest

from trinoc.geometry import project
from trinoc.synth import table1_rig
from trinoc.synth.rigs import TABLE_1, random_rig


def test_table_1_is_the_paper_s():
    rig = table1_rig()
    assert rig.names == ("upper", "left", "right")
    for name, camera in rig.items():
        parameters = (camera.pan_deg, camera.tilt_deg, camera.swing_deg, camera.distance_mm)
        assert parameters == pytest.approx(TABLE_1[name], abs=1e-9)
        assert camera.image_size_px == (512, 480)
        assert camera.intrinsics.focal_length_px == pytest.approx([16 / 0.0162, 16 / 0.0134])


@pytest.mark.parametrize("resolution", [2, 4])
def test_resolution_divides_each_pixel_and_keeps_the_field_of_view(resolution):
    coarse, fine = table1_rig()["left"], table1_rig(resolution=resolution)["left"]
    point = np.array([31.0, -17.0, 12.0])
    u = np.asarray(project(coarse, point))
    # The centre of a pixel is half a pixel from its border, whatever the pixel's size.
    np.testing.assert_allclose(
        (np.asarray(project(fine, point)) + 0.5) / resolution - 0.5, u, atol=1e-9
    )


@pytest.mark.parametrize("wide", [False, True])
def test_random_rigs_repeat_by_seed_and_look_at_the_origin(wide):
    for seed in range(10):
        rig, same_seed = random_rig(seed, wide=wide), random_rig(seed, wide=wide)
        np.testing.assert_array_equal(rig.matrices_px, same_seed.matrices_px)
        for _, camera in rig.items():
            np.testing.assert_allclose(project(camera, np.zeros(3)), [255.5, 239.5], atol=1e-9)
            assert 20 <= camera.tilt_deg <= 80
            assert abs(camera.pan_deg) <= 60
    assert not np.allclose(random_rig(0).matrices_px, random_rig(1).matrices_px)
