"""Sharpness, exposure, coverage and lean against what was put in."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.capture.made import GRID_MM, SIZE_PX, camera, rectangle, step_picture
from tests.capture.made_boards import CHESSBOARD, SHEET, board_picture, hold_board, move_poses
from trinoc.calib.targets.abstract_target import AbstractBoard
from trinoc.capture.image_quality import measure_quality
from trinoc.capture.measures import (
    GRID,
    cover_cells,
    edge_blur_px,
    measure_exposure,
    measure_lean,
)
from trinoc.geometry.camera import depth_mm
from trinoc.image.light import Light


@pytest.mark.parametrize("blur_px", [0.7, 1.0, 2.0, 4.0])
@pytest.mark.parametrize(("contrast", "noise"), [(200.0, 0.0), (60.0, 0.5), (200.0, 2.0)])
def test_the_blur_of_an_edge_is_found(blur_px: float, contrast: float, noise: float) -> None:
    for turn_deg in (0.0, 27.0, 90.0):
        measured_px = edge_blur_px(step_picture(blur_px, contrast, noise, turn_deg))
        assert measured_px == pytest.approx(blur_px, rel=0.15, abs=0.1)


def test_blur_does_not_depend_on_the_unit_of_grey() -> None:
    picture = step_picture(1.5, 150.0, 0.0, 20.0)
    assert edge_blur_px(16 * picture) == pytest.approx(edge_blur_px(picture), rel=1e-4)


def test_where_there_is_no_edge_no_blur_is_told() -> None:
    assert np.isnan(edge_blur_px(np.full((60, 80), 90.0, dtype=np.float32)))


@given(saturated=st.integers(0, 40), dark=st.integers(0, 40), bits=st.sampled_from([8, 10, 12, 16]))
def test_shares_of_saturated_and_dark_pixels_in_any_depth(
    saturated: int, dark: int, bits: int
) -> None:
    full = 2**bits - 1
    picture = np.full((20, 20), full // 2, dtype=np.uint16 if bits > 8 else np.uint8)
    picture.flat[:saturated] = full
    picture.flat[picture.size - dark :] = 0
    # One full pixel tells the range of a deeper picture.
    picture.flat[0] = full
    exposure = measure_exposure(Light.from_picture(picture).levels)
    assert exposure.saturated == pytest.approx(max(saturated, 1) / 400)
    assert exposure.dark == pytest.approx(dark / 400)


def test_cells_are_covered_where_places_are_and_between_them() -> None:
    columns = GRID[1]
    assert cover_cells(rectangle(0.01, 0.01, 0.99, 0.99), SIZE_PX).all()
    half = cover_cells(rectangle(0.01, 0.01, 0.49, 0.99), SIZE_PX)
    assert half[:, : columns // 2].all()
    assert not half[:, columns // 2 :].any()
    corners = rectangle(0.01, 0.01, 0.99, 0.99)[[0, 4, 20, 24]]
    assert cover_cells(corners, SIZE_PX).all()
    assert not cover_cells(np.zeros((0, 2)), SIZE_PX).any()


@given(pan=st.floats(-40, 40), tilt=st.floats(35, 90))
def test_lean_is_the_depth_from_side_to_side(pan: float, tilt: float) -> None:
    eye = camera(pan, tilt)
    matrix = np.asarray(eye.matrix_px)
    homogeneous = np.column_stack([GRID_MM, np.zeros(25), np.ones(25)]) @ matrix.T
    points_px = homogeneous[:, :2] / homogeneous[:, 2:]
    lean = np.array(measure_lean(GRID_MM, points_px))
    centre, ends = homogeneous[:, 2].mean(), np.ptp(homogeneous[:, 2])
    # Along the steepest way it is the whole difference of depth over the places' extent.
    assert np.abs(lean).max() <= ends / centre + 0.02
    assert lean @ lean >= (0.4 * ends / centre) ** 2
    # The optical axis leans up: what is up in the picture is farther away.
    if tilt < 80:
        assert lean[1] < 0


def test_a_board_square_to_the_camera_does_not_lean() -> None:
    np.testing.assert_allclose(measure_lean(GRID_MM, 2.0 * GRID_MM + 100.0), 0.0, atol=1e-9)
    assert measure_lean(GRID_MM[:5], GRID_MM[:5]) == (0.0, 0.0)
    assert float(depth_mm(camera(0.0, 90.0), np.zeros(3))) == pytest.approx(300.0)


@pytest.mark.parametrize("board", [CHESSBOARD, SHEET], ids=["chessboard", "sheet"])
@pytest.mark.parametrize("roll_deg", [0.0, 25.0, 45.0])
@pytest.mark.parametrize("along", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
def test_a_board_that_moves_along_its_own_edges_is_blurred(
    roll_deg: float, along: tuple[float, float, float], board: AbstractBoard
) -> None:
    """Half of its edges stay sharp then; a smear of n px is a box of n / sqrt(12)."""
    pose = hold_board((0.0, 0.0, 320.0), (0.0, 0.0, roll_deg), board)
    still = measure_quality("still", board_picture("left", [pose], board=board), board)
    smear_px = 9.0
    by_mm = np.array(along) * smear_px * 320.0 / 520.0
    moved = measure_quality(
        "moved", board_picture("left", move_poses(pose, by_mm), board=board), board
    )
    assert still.blur_px == pytest.approx(0.7, abs=0.25)
    assert not still.faults
    if moved.is_detected:
        across = smear_px / np.sqrt(12.0) * max(np.cos(np.radians([roll_deg, 90.0 - roll_deg])))
        assert moved.blur_px > 0.8 * across


def test_a_picture_without_an_edge_says_so() -> None:
    blank = np.full((480, 512), 128, np.uint8)
    assert [fault.split(":")[0] for fault in measure_quality("a", blank, SHEET).faults] == [
        "the picture has almost no edges"
    ]
