"""Single precision for pixels must not show in the pose, however many pixels there are."""

import jax
import numpy as np

from tests.calib.simulated import TABLE_1, reference_sheet
from trinoc.calib.photometric.appearance import Appearance
from trinoc.calib.photometric.gauss_newton import sheet_from_camera
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.calib.photometric.normal_equations import NormalEquations, normal_equations
from trinoc.calib.photometric.pixel_selection import group_of, select_pixels
from trinoc.calib.result.degrees import pose_of_values
from trinoc.numerics import GemanMcClure
from trinoc.synth import table1_rig

CROSS = Cross(np.array(0.5), np.array([55.0, 55.0]), np.array(1.5))
LOOK = Appearance(
    np.array(np.hypot(0.7, np.sqrt(1 / 12))),
    np.array(0.0),
    np.array(25 / 230 - 1),
    np.array([230.1, 1.3, -0.7, 0.0, 0.0, 0.0]),
)


def test_rounding_of_the_unknowns_moves_no_large_picture() -> None:
    camera, pattern = table1_rig(resolution=8)["left"], reference_sheet()
    lens, size = camera.intrinsics.lens, camera.intrinsics.image_size_px
    pose = pose_of_values(np.array((*TABLE_1["left"], 0.0, 0.0)))
    chosen = select_pixels(pose, lens, pattern, size, float(LOOK.sigma_px)).near_circles
    chosen = chosen.part(np.arange(0, len(chosen.row), 8))
    homography = np.asarray(sheet_from_camera(pose))

    def sums(grey: np.ndarray, dtype: type) -> NormalEquations:
        group = group_of(chosen, grey, lens, pattern, 65536, dtype)
        return jax.jit(normal_equations, static_argnames=("drawing", "near_line"))(
            homography,
            LOOK,
            group.pixels,
            group.chunks,
            CROSS,
            GemanMcClure.from_scale(np.array(np.inf)),
            drawing=Drawing("stop", False),
            near_line=False,
        )

    grey = np.zeros(size[::-1])
    predicted = np.asarray(sums(grey, np.float64).residuals)[: len(chosen.row)]
    grey[chosen.row, chosen.column] = predicted
    single = sums(grey, np.float32)
    # The model is the picture: what gradient there is comes of rounding. The unknowns that one
    # plane leaves open have no scale of their own, and no step.
    matrix, gradient = np.asarray(single.matrix), np.asarray(single.gradient)
    scale = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / scale / scale[:, None])
    known = values > 1e-12 * values[-1]
    along = (vectors.T @ (gradient / scale))[known] / np.sqrt(values[known])
    assert np.linalg.norm(along) < 0.03
