"""Depth pictures agree with the true depth of the scene."""

import numpy as np
import pytest

from tests.match.made import pictures, rig_of
from trinoc.errors import InputError
from trinoc.match import depth_map
from trinoc.match.matcher import match_segments

CORNERS = np.array([[-20, -15, 5], [25, -15, 5], [25, 20, 12], [-20, 20, 12]], dtype=float)
SQUARE = np.stack([CORNERS, np.roll(CORNERS, -1, axis=0)], axis=1)


def test_an_open_loop_is_not_filled() -> None:
    rig = rig_of("upper", "left", "right")
    matches = match_segments(pictures(rig, SQUARE[:3]), rig, sigma_px=0.1)
    sparse, filled = (depth_map(matches, rig, "upper", filled=filled) for filled in (False, True))
    np.testing.assert_array_equal(filled, sparse)


def test_depth_is_that_of_the_lines_and_of_the_plane_between() -> None:
    rig = rig_of("upper", "left", "right")
    matches = match_segments(pictures(rig, SQUARE), rig, sigma_px=0.1)
    assert len(matches) == 4
    sparse = depth_map(matches, rig, "upper")
    filled = depth_map(matches, rig, "upper", filled=True)
    on_lines = np.isfinite(sparse)
    assert 150 < on_lines.sum() < np.isfinite(filled).sum() / 5
    # By hand: where the ray of each pixel meets the plane through three corners.
    normal = np.cross(CORNERS[1] - CORNERS[0], CORNERS[3] - CORNERS[0])
    matrix = rig["upper"].matrix_px
    centre = rig["upper"].centre_world_mm
    row, column = np.nonzero(np.isfinite(filled))
    rays = np.linalg.solve(matrix[:, :3], np.stack([column, row, np.ones(len(row))]))
    points = centre[:, None] + ((CORNERS[0] - centre) @ normal) / (normal @ rays) * rays
    depth = matrix[2, :3] @ points + matrix[2, 3]
    # Along the lines a pixel stands for points up to a pixel away.
    np.testing.assert_allclose(filled[row, column], depth, atol=1.0)
    inner = np.isfinite(filled) & ~on_lines
    np.testing.assert_allclose(filled[inner], depth[inner[row, column]], atol=1e-3)


def test_unknown_view_is_refused() -> None:
    rig = rig_of("upper", "left", "right")
    matches = match_segments(pictures(rig, SQUARE), rig, sigma_px=0.1)
    with pytest.raises(InputError, match='"top"'):
        depth_map(matches, rig, "top")
