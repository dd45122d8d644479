"""Single precision of the pixels does not change the pose, for any number of pixels."""

import numpy as np

from tests.calib.photometric.pictures import drawing_of, pose_of, rows_of
from tests.calib.simulated import TABLE_1, reference_sheet
from trinoc.calib.photometric.pixel_selection import pad_group, select_pixels
from trinoc.calib.photometric.unknowns import ideal_state
from trinoc.synth import table1_rig


def test_rounding_of_the_unknowns_moves_no_large_picture() -> None:
    camera, pattern = table1_rig(resolution=8)["left"], reference_sheet()
    lens, size = camera.intrinsics.lens, camera.intrinsics.image_size_px
    pose = pose_of((*TABLE_1["left"], 0.0, 0.0))
    state = ideal_state(pose, 0.757, 25 / 230 - 1, np.array([230.1, 1.3, -0.7]))
    selected = select_pixels(pose, lens, pattern, size, 2.7).near_circles
    selected = selected.subset(np.arange(0, len(selected.row), 8))
    grey = np.zeros(size[::-1])

    def residuals_and_rows(dtype: type) -> tuple[np.ndarray, np.ndarray]:
        group = pad_group(selected, grey, lens, pattern, len(selected.row), dtype)
        rows = rows_of(state, group, drawing=drawing_of(pattern))
        return np.asarray(rows.level, float) - np.asarray(group.pixels.grey, float), np.asarray(
            rows.rows, float
        )

    exact, rows = residuals_and_rows(np.float64)
    grey[selected.row, selected.column] = exact
    # The model is the picture: what residuals there are come of rounding. The unknowns that one
    # plane leaves open have no scale of their own, and no step.
    residual, _ = residuals_and_rows(np.float32)
    matrix, gradient = rows @ rows.T, rows @ residual
    scale = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / scale / scale[:, None])
    determined = values > 1e-12 * values[-1]
    along = (vectors.T @ (gradient / scale))[determined] / np.sqrt(values[determined])
    assert np.linalg.norm(along) < 0.03
