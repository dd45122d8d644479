"""Covariance that errors of the rig add to each line of the matches."""

from pathlib import Path

import numpy as np
import pytest

import trinoc
from tests.match.made import loose_lines, pictures, rig_of
from trinoc.evaluation.lines_of_rig import with_rig_covariance
from trinoc.geometry.camera import Camera
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import Rig
from trinoc.match.matcher import match_segments

VIEWS = ("upper", "left", "right")


def turned(rig: Rig, name: str, pan_deg: float) -> Rig:
    """The rig with one camera panned further by this angle."""
    camera = rig[name]
    moved = Camera.from_degrees(
        camera.intrinsics,
        pan_deg=camera.pan_deg + pan_deg,
        tilt_deg=camera.tilt_deg,
        swing_deg=camera.swing_deg,
        distance_mm=camera.distance_mm,
    )
    return Rig(dict(rig.items()) | {name: moved})


def across(lines_mm: np.ndarray) -> np.ndarray:
    """(t, 3, 3) projection onto the plane perpendicular to each line."""
    offset = lines_mm[:, 1] - lines_mm[:, 0]
    unit = offset / np.linalg.norm(offset, axis=1, keepdims=True)
    return np.eye(3) - unit[:, :, None] * unit[:, None]


@pytest.mark.parametrize("name", VIEWS)
def test_lines_move_with_a_camera_by_what_the_covariance_of_its_pan_says(
    name: str, tmp_path: Path
) -> None:
    """A camera pan of one sigma moves each line across itself by the root of the covariance."""
    rig, sigma_deg = rig_of(*VIEWS), 1e-3
    segments = pictures(rig, loose_lines(20, seed=3))
    parameters = [
        f"{view}.{parameter}" for view in VIEWS for parameter in PoseModel.AIMED.parameter_names
    ]
    variance = [sigma_deg**2 * (parameter == f"{name}.pan_deg") for parameter in parameters]
    uncertain_rig = Rig(dict(rig.items()), parameters=parameters, covariance=np.diag(variance))
    matches = match_segments(segments, uncertain_rig)
    with_rig = with_rig_covariance(matches, uncertain_rig)
    covariance = with_rig.rig_covariance_mm2
    assert covariance is not None
    # One error moves all: the covariance has rank 1, and its file is read all the same.
    trinoc.save(with_rig, tmp_path / "matches.npz")
    assert trinoc.load_matches(tmp_path / "matches.npz") == with_rig
    moved = match_segments(segments, turned(rig, name, sigma_deg))
    np.testing.assert_array_equal(moved.index, matches.index)
    off = np.einsum("tij,tej->tei", across(matches.lines_mm), moved.lines_mm - matches.lines_mm)
    expected = np.einsum("tei,tfj->teifj", off, off)
    both = np.kron(np.eye(2), across(matches.lines_mm))
    stated = (both @ covariance @ both.transpose(0, 2, 1)).reshape(expected.shape)
    np.testing.assert_allclose(stated, expected, atol=0.05 * expected.max())


def test_a_covariance_of_one_camera_alone_says_nothing_of_lines() -> None:
    rig = rig_of(*VIEWS)
    part = Rig(dict(rig.items()), parameters=("left.pan_deg",), covariance=np.eye(1))
    matches = match_segments(pictures(rig, loose_lines(20, seed=3)), part)
    assert with_rig_covariance(matches, part).rig_covariance_mm2 is None


def test_a_rig_of_unknown_errors_adds_nothing_that_is_known() -> None:
    rig = rig_of(*VIEWS)
    matches = match_segments(pictures(rig, loose_lines(20, seed=3)), rig)
    assert with_rig_covariance(matches, rig).rig_covariance_mm2 is None
