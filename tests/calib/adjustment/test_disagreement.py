"""When two answers of one picture differ, and when blocks of a sheet do."""

import numpy as np

from tests.calib.adjustment.made_views import SHEET, SIGMA_PX, TYPICAL, made_views
from trinoc.calib.adjustment.agreement import probability_of_agreement
from trinoc.calib.adjustment.estimate import Adjustment, adjust_cameras
from trinoc.calib.adjustment.jackknife import scatter_of_blocks
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.sheet_points import SheetPoints
from trinoc.geometry import PoseModel


def adjusted(cameras) -> Adjustment:
    return adjust_cameras(cameras, SHEET, TYPICAL, PoseModel.AIM_FREE, TYPICAL.aim_sigma_mm)


def test_right_answers_agree_and_wrong_ones_do_not() -> None:
    probabilities, refuted = [], []
    for seed in range(20):
        (camera,) = made_views(seed, cameras=("left",)).cameras
        circles = adjusted([camera])
        # Grey levels know the same places better, by what makes the circles' image centres less
        # the images of their centres.
        residuals = circles.near.residual[0][: 2 * len(SHEET)].reshape(-1, 2) * SIGMA_PX
        better = SheetPoints(
            SHEET.centres_mm,
            _images_px(circles) - residuals,
            np.eye(2 * len(SHEET)) * np.sqrt(1.75) / SIGMA_PX,
        )
        same = adjusted([camera._replace(shown=better)])
        probabilities.append(probability_of_agreement(circles, same, 0))
        shifted = better._replace(uv_px=better.uv_px + 6 * SIGMA_PX / 8)
        other = adjusted([camera._replace(shown=shifted)])
        refuted.append(probability_of_agreement(circles, other, 0))
    # The same centres: no difference at all.
    assert min(probabilities) > 0.5
    assert max(refuted) < 1e-3


def _images_px(circles: Adjustment) -> np.ndarray:
    """The images of the circles' centres, as an adjustment has them."""
    problem = circles.problem
    flat = type(problem.chart)(**{**vars(problem.chart), "has_circles": False})
    errors = errors_px(problem._replace(chart=flat))[0]
    return errors + problem.views[0].detection.centres_px


def scatters(shared_px: float) -> list[float]:
    """Of 20 pictures whose circles share an error with those of their block."""
    found = []
    for seed in range(20):
        (camera,) = made_views(seed, cameras=("upper",)).cameras
        places = SHEET.centres_mm
        cell = np.floor((places - places.min()) / 81 * 4).astype(int)
        block = np.random.default_rng([3, seed]).normal(size=(4, 4, 2))[cell[:, 0], cell[:, 1]]
        camera.detection.centres_px[:] += shared_px * block
        found.append(scatter_of_blocks(adjusted([camera]), 0))
    return found


def test_blocks_scatter_as_claimed_unless_neighbours_share_an_error() -> None:
    alone, shared = scatters(0.0), scatters(3 * SIGMA_PX)
    assert np.mean(alone) < 1.2
    assert np.mean(shared) > np.mean(alone) + 0.1
