"""Gratings come out with the contrast that theory gives them, edges with its profile."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr

from simulation.camera_picture.optics import Optics, irradiance
from simulation.camera_picture.scene import MARGIN_PX
from tests.simulation.camera_picture.views import CELLS, radiance_of
from trinoc.errors import InputError

SIDE_PX = 96 + 2 * MARGIN_PX


def grating(waves_u, waves_v):
    """Means over the cells of 1 + cos(2 pi f . x), x from the margin's first pixel's centre."""
    fu, fv = waves_u / SIDE_PX, waves_v / SIDE_PX
    position_px = (np.arange(SIDE_PX * CELLS) + 0.5) / CELLS - 0.5
    phase = 2 * np.pi * (fu * position_px[None, :] + fv * position_px[:, None])
    return 1 + np.sinc(fu / CELLS) * np.sinc(fv / CELLS) * np.cos(phase)


def light_of(cells, optics):
    return irradiance(radiance_of(cells, MARGIN_PX), optics)


def contrast(waves_u, waves_v, optics):
    picture = light_of(grating(waves_u, waves_v), optics)
    position_px = np.arange(MARGIN_PX, SIDE_PX - MARGIN_PX)
    phase = 2 * np.pi * (waves_u * position_px[None, :] + waves_v * position_px[:, None]) / SIDE_PX
    basis = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=-1).reshape(-1, 3)
    mean, cosine, sine = np.linalg.lstsq(basis, picture.ravel())[0]
    assert mean == pytest.approx(1.0)
    assert sine == pytest.approx(0.0, abs=1e-10)
    return cosine


def mean_over_disc(frequency, radius):
    def chord(x):
        return 2 * np.sqrt(radius**2 - x**2) * np.cos(2 * np.pi * frequency * x)

    return quad(chord, -radius, radius)[0] / (np.pi * radius**2)


@pytest.mark.parametrize(("waves_u", "waves_v"), [(5, 0), (0, 17), (21, -13), (40, 30)])
def test_contrast_of_gratings(waves_u, waves_v):
    fu, fv = waves_u / SIDE_PX, waves_v / SIDE_PX
    pixel = np.sinc(fu) * np.sinc(fv)
    gaussian = np.exp(-2 * (np.pi * 0.7) ** 2 * (fu**2 + fv**2))
    assert contrast(waves_u, waves_v, Optics()) == pytest.approx(pixel * gaussian, abs=1e-10)
    disc = mean_over_disc(np.hypot(fu, fv), 1.5)
    # Narrow, but wide enough for cells of an eighth of a pixel to sample it.
    narrow = np.exp(-2 * (np.pi * 0.3) ** 2 * (fu**2 + fv**2))
    soft = Optics(blur_px=0.3, defocus_px=1.5)
    assert contrast(waves_u, waves_v, soft) == pytest.approx(pixel * narrow * disc, abs=1e-9)
    along = np.cos(np.radians(25.0)) * fu + np.sin(np.radians(25.0)) * fv
    moving = Optics(blur_px=0.3, motion_px=3.0, motion_deg=25.0)
    expected = pixel * np.sinc(3.0 * along)
    assert contrast(waves_u, waves_v, moving) == pytest.approx(narrow * expected, abs=1e-9)
    together = Optics(0.7, 1.5, 3.0, 25.0)
    expected *= gaussian * disc
    assert contrast(waves_u, waves_v, together) == pytest.approx(expected, abs=1e-9)


def test_without_a_lens_a_pixel_is_the_mean_of_its_cells():
    fine = np.random.default_rng(0).uniform(size=(SIDE_PX * CELLS, SIDE_PX * CELLS))
    means = fine.reshape(SIDE_PX, CELLS, SIDE_PX, CELLS).mean(axis=(1, 3))
    inner = means[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    np.testing.assert_allclose(light_of(fine, Optics(blur_px=0.0)), inner, atol=1e-12)


def test_an_edge_has_the_profile_of_a_blurred_box():
    cells = np.zeros((SIDE_PX * CELLS, SIDE_PX * CELLS))
    # From a quarter of a pixel right of a pixel's centre on.
    first = (MARGIN_PX + 40) * CELLS + 3 * CELLS // 4
    last = (SIDE_PX - MARGIN_PX - 10) * CELLS
    cells[:, first:last] = 1.0
    profile = light_of(cells, Optics(blur_px=0.8))[30, 30:50]

    def integral(z):
        return z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)

    distance = np.arange(30, 50) - 40.25
    expected = 0.8 * (integral((distance + 0.5) / 0.8) - integral((distance - 0.5) / 0.8))
    # Cells are samples: what an edge on their border folds back is (f / CELLS)^2 of it, for the
    # frequencies f of a third of a cycle per pixel that such a blur lets through.
    np.testing.assert_allclose(profile, expected, atol=(0.33 / CELLS) ** 2)


def test_a_blur_that_reaches_beyond_the_margin_is_refused():
    cells = np.ones((40 * CELLS, 40 * CELLS))
    with pytest.raises(InputError, match="blur it less"):
        light_of(cells, Optics(blur_px=3.0, defocus_px=4.0))
