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


def scatters(shared_px: float) -> list[float]:
    """Of 20 pictures whose circles share an error with those of their block."""
    found = []
    for seed in range(20):
        view = made_views(seed, cameras=("upper",)).views[0]
        places = view.points.place_mm
        cell = np.floor((places - places.min()) / 81 * 4).astype(int)
        block = np.random.default_rng([3, seed]).normal(size=(4, 4, 2))[cell[:, 0], cell[:, 1]]
        uv = view.points.uv_px + shared_px * block
        points = view.points._replace(uv_px=uv)
        answer = adjusted([view._replace(points=points, has_outliers=False)])
        found.append(scatter_of_blocks(answer, places, 0))
    return found


def test_blocks_scatter_as_claimed_unless_neighbours_share_an_error() -> None:
    alone, shared = scatters(0.0), scatters(3 * SIGMA_PX)
    assert np.mean(alone) < 1.2
    assert np.mean(shared) > np.mean(alone) + 0.1
