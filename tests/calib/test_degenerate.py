"""Sheets and points that determine no camera are named. The cases are those of docs/limits.md."""

import numpy as np
import pytest

import trinoc
from simulation.camera_picture.render import render_sheet
from trinoc.calib.detection.registry import detect_pattern
from trinoc.errors import TrinocError
from trinoc.geometry.camera import Camera
from trinoc.synth import table1_lens, table1_rig

RIG, LENS = table1_rig(), table1_lens()
PATTERN = trinoc.Pattern.cross_grid(rows=6, columns=6, pitch_mm=24.0, radius_mm=7.0)
TINY = trinoc.Intrinsics(focal_length_mm=16.0, pixel_pitch_mm=(0.01, 0.01), image_size_px=(12, 10))
STEPS_MM = 20.0 * np.arange(-3, 4)


def picture(camera=RIG["upper"], pattern=PATTERN):
    return render_sheet(pattern, camera, supersampling=2, noise_sigma=1.0)


def by_points(points_mm):
    image = points_mm @ RIG["upper"].matrix_px[:, :3].T + RIG["upper"].matrix_px[:, 3]
    return trinoc.calibrate_points(points_mm, image[:, :2] / image[:, 2:], LENS)


def calibrated(**images):
    return trinoc.calibrate(images, PATTERN, LENS, method="points")


def folded():
    """Calibrate with k1 of another sign and size than any real lens has."""
    lens = table1_lens(distortion=(-50.0,))
    return trinoc.calibrate({"upper": picture()}, PATTERN, lens, method="points")


def edge_on():
    camera = Camera.from_degrees(LENS, pan_deg=0.0, tilt_deg=3.0, swing_deg=0.0, distance_mm=470.0)
    return calibrated(upper=picture(camera))


def one_row():
    pattern = trinoc.Pattern.circle_grid(rows=1, columns=6, pitch_mm=24.0, radius_mm=7.0)
    return trinoc.calibrate({"upper": picture(pattern=pattern)}, pattern, LENS)


CASES = {
    "sheet edge-on": (
        edge_on,
        "was found in the image; check that the sheet is flat, uncovered, in focus",
    ),
    "a lens that folds": (
        folded,
        ", because the lens folds the image 54 px from the principal point",
    ),
    "all circles in one line": (one_row, "has too few circles, or all on one line"),
    "all points in one line": (
        lambda: by_points(np.stack([STEPS_MM, STEPS_MM, 0 * STEPS_MM], axis=1)),
        "do not spread enough to determine a pose: give points that spread in depth and across",
    ),
    "all points at one place": (
        lambda: by_points(np.full((8, 3), 5.0)),
        "points do not spread enough to determine a pose",
    ),
    "a picture of a few pixels": (
        lambda: trinoc.calibrate({"upper": np.zeros((10, 12))}, PATTERN, TINY),
        'Camera "upper": The picture is 12 x 10 px',
    ),
    "identical pictures": (
        lambda: calibrated(upper=picture(), left=picture()),
        "The same image was given for cameras",
    ),
    "mirrored picture": (
        lambda: calibrated(upper=picture()[:, ::-1].copy()),
        "mirrored; flip the image left to right, or photograph the printed side.",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_tells_no_camera_is_named(case):
    call, sentence = CASES[case]
    with pytest.raises(TrinocError) as caught:
        call()
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_circles_below_a_black_bar_are_left_out_without_a_warning():
    """The bar stands for lost rows of the image. Warnings are errors here."""
    first, last = 200, 259
    lost = picture()
    lost[first : last + 1] = 0
    rows = detect_pattern(lost, PATTERN).centres_px[:, 1]
    assert len(rows) > 6
    assert not ((rows > first) & (rows < last)).any()
