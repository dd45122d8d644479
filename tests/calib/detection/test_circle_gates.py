"""The gates admit only circles of the expected position and shape, and these have true sigmas."""

import numpy as np
import pytest

from simulation.camera_picture.render import render_sheet
from tests.calib.detection.test_corners import overexposed, shared, sharpened, white
from tests.calib.simulated import TABLE_1, camera_of, reference_sheet
from trinoc.calib import detect_pattern
from trinoc.calib.detection.ellipse_fit import Ellipses
from trinoc.calib.detection.quality_gate import are_plausible, select_agreeing
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.image_of_circle import image_of_circle_centre

SHEET = reference_sheet()
PX_PER_MM = np.array([[3.0, 0.4], [-0.2, 2.5]])


def exact_circles() -> Ellipses:
    """Exact ellipses of a sheet under an affine map."""
    count = len(SHEET.centres_mm)
    one, nothing = np.ones(count), np.zeros(count)
    radius = np.asarray(SHEET.radius_mm)[:, None, None]
    return Ellipses(
        np.asarray(SHEET.centres_mm) @ PX_PER_MM.T + 500.0,
        radius**2 * (PX_PER_MM @ PX_PER_MM.T),
        *(one, 200 * one, 0.8 * one, nothing, 0.01 * one, np.zeros((count, 2))),
        *(np.tile(1e-6 * np.eye(2), (count, 1, 1)), 0.1 * one, one),
    )


def test_a_circle_a_radius_from_its_place_is_not_plausible() -> None:
    exact = exact_circles()
    centres_px = exact.centres_px.copy()
    # In units of the ellipse, of which half a one is allowed.
    root = np.linalg.cholesky(exact.shape_px2)
    centres_px[3] += root[3] @ [0.6, 0.0]
    centres_px[4] += root[4] @ [0.0, 0.4]
    plausible = are_plausible(exact, centres_px, exact.shape_px2, 0.5)
    assert np.flatnonzero(~plausible).tolist() == [3]


def test_a_circle_of_another_shape_does_not_agree_though_it_lies_right() -> None:
    exact = exact_circles()
    shape = exact.shape_px2.copy()
    shape[5] = np.diag([1.3, 1 / 1.3]) @ shape[5] @ np.diag([1.3, 1 / 1.3])
    index = np.arange(len(shape))
    good, _ = select_agreeing(exact._replace(shape_px2=shape), index, SHEET, TUNING)
    assert np.flatnonzero(~good).tolist() == [5]


@pytest.fixture(scope="module")
def light():
    levels = render_sheet(SHEET, camera_of(TABLE_1["left"]), bits=None, supersampling=8)
    return levels / 255


@pytest.mark.parametrize("deliver", [white, shared, overexposed, sharpened])
def test_circles_are_off_by_what_they_claim(light, deliver):
    """The normalised errors are 1 within a quarter, for any noise and light.

    The sigmas of 64 circles together are known to .06.
    """
    detection = detect_pattern(deliver(light, np.random.default_rng(3)) / 255, SHEET)
    camera, index = camera_of(TABLE_1["left"]), detection.circle_index
    circles = zip(SHEET.centres_mm[index], SHEET.radius_mm[index], strict=True)
    off = detection.centres_px - [image_of_circle_centre(camera, *circle) for circle in circles]
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(detection.covariance_px2), off)
    assert 0.75 < np.sqrt(np.mean(squared) / 2) < 1.25
