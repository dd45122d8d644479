"""Circles that a sheet cannot show there, or not of that shape, are let in by no gate."""

import numpy as np

from tests.calib.simulated import reference_sheet
from trinoc.calib.detection.ellipse_fit import Ellipses
from trinoc.calib.detection.quality_gate import are_plausible, select_agreeing

SHEET = reference_sheet()
PX_PER_MM = np.array([[3.0, 0.4], [-0.2, 2.5]])


def exact_circles() -> Ellipses:
    """Of a sheet under an affine map, without error."""
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
    places = exact.centres_px.copy()
    # In units of the ellipse, of which half a one is allowed.
    root = np.linalg.cholesky(exact.shape_px2)
    places[3] += root[3] @ [0.6, 0.0]
    places[4] += root[4] @ [0.0, 0.4]
    plausible = are_plausible(exact, places, exact.shape_px2, 0.5)
    assert np.flatnonzero(~plausible).tolist() == [3]


def test_a_circle_of_another_shape_does_not_agree_though_it_lies_right() -> None:
    exact = exact_circles()
    shape = exact.shape_px2.copy()
    shape[5] = np.diag([1.3, 1 / 1.3]) @ shape[5] @ np.diag([1.3, 1 / 1.3])
    index = np.arange(len(shape))
    good, _ = select_agreeing(exact._replace(shape_px2=shape), index, SHEET)
    assert np.flatnonzero(~good).tolist() == [5]
