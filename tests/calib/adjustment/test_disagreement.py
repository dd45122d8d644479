"""When two answers of one picture differ, and when blocks of a sheet do."""

import numpy as np

from tests.calib.adjustment.made_views import SIGMA_PX, TYPICAL, made_views
from trinoc.calib.adjustment import (
    Adjustment,
    adjusted_views,
    probability_of_agreement,
    scatter_of_blocks,
)
from trinoc.geometry import PoseModel


def adjusted(views) -> Adjustment:
    return adjusted_views(views, TYPICAL, PoseModel.AIM_FREE, TYPICAL.aim_sigma_mm)


def test_right_answers_agree_and_wrong_ones_do_not() -> None:
    probabilities, refuted = [], []
    for seed in range(20):
        views = made_views(seed, cameras=("left",)).views
        circles = adjusted(views)
        points = views[0].points
        better = views[0]._replace(
            points=points._replace(whitening=points.whitening * np.sqrt(1.75))
        )
        probabilities.append(probability_of_agreement(circles, adjusted([better]), points, 0))
        shifted = better._replace(
            points=better.points._replace(uv_px=better.points.uv_px + 6 * SIGMA_PX / 8)
        )
        refuted.append(probability_of_agreement(circles, adjusted([shifted]), points, 0))
    # The same centres: no difference at all.
    assert min(probabilities) > 0.5
    assert max(refuted) < 1e-3


def test_noise_that_circles_do_not_share_scatters_blocks_as_claimed() -> None:
    scatter = []
    for seed in range(20):
        view = made_views(seed, cameras=("upper",)).views[0]
        scatter.append(scatter_of_blocks(adjusted([view]), view.points.place_mm, 0))
    assert np.mean(scatter) < 1.25


def test_errors_that_neighbours_share_scatter_blocks() -> None:
    view = made_views(1, cameras=("upper",)).views[0]
    random = np.random.default_rng(3)
    cell = np.floor((view.points.place_mm + 80) / 40).astype(int)
    shared = 5 * SIGMA_PX * random.normal(size=(4, 4, 2))[cell[:, 0], cell[:, 1]]
    points = view.points._replace(uv_px=view.points.uv_px + shared)
    found = adjusted([view._replace(points=points, has_outliers=False)])
    assert scatter_of_blocks(found, points.place_mm, 0) > 1.3
