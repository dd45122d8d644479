"""Tests of agreement: two estimates from one image, and the blocks of one sheet."""

import dataclasses

import numpy as np
import pytest

from tests.calib.adjustment.made_views import SHEET, SIGMA_PX, TYPICAL, made_views
from trinoc.calib.adjustment.adjustment import Adjustment, adjust
from trinoc.calib.adjustment.agreement import (
    choose_observations,
    difference_of_estimates,
    probability_of_agreement,
    scatter_of_blocks,
)
from trinoc.calib.problem.rao_test import score_of_residuals
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.sheet_problem import GreyLevelFit, SheetCamera, SheetPriors
from trinoc.calib.problem.views import SheetPoints
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.pose import PoseModel


def adjusted(cameras, systematics: Systematics = TYPICAL) -> Adjustment:
    return adjust(cameras, SHEET, SheetPriors(PoseModel.AIMED, systematics))


def test_right_answers_agree_and_wrong_ones_do_not() -> None:
    probabilities, refuted = [], []
    for seed in range(20):
        (camera,) = made_views(seed, cameras=("left",)).cameras
        circles = adjusted([camera])
        # Grey levels know the same places better, by what makes the circles' image centres less
        # the images of their centres.
        better = SheetPoints(
            SHEET.centres_mm,
            _images_px(circles) - _residuals_px(circles),
            np.eye(2 * len(SHEET)) * np.sqrt(1.75) / SIGMA_PX,
        )
        same = adjusted([dataclasses.replace(camera, grey_level_points=better)])
        probabilities.append(probability_of_agreement(circles, same, 0))
        shifted = better._replace(uv_px=better.uv_px + 6 * SIGMA_PX / 8)
        other = adjusted([dataclasses.replace(camera, grey_level_points=shifted)])
        refuted.append(probability_of_agreement(circles, other, 0))
    # The same centres: no difference at all.
    assert min(probabilities) > 0.5
    assert max(refuted) < 1e-3


@pytest.mark.parametrize("circles_know_more", [False, True])
def test_answers_of_one_picture_differ_as_chi_square_does(circles_know_more: bool) -> None:
    """Over 4,000 images, one estimate is the other one plus noise of its own."""
    random = np.random.default_rng(0)
    few, more = random.normal(size=(30, 4)), random.normal(size=(40, 4))
    many = np.concatenate([few, 1.5 * more])
    by_circles, by_grey = (many, few) if circles_know_more else (few, many)
    of_few, of_many = (np.linalg.inv(rows.T @ rows) for rows in (few, many))
    root = np.linalg.cholesky(of_few - of_many)
    squared = [
        difference_of_estimates(by_circles @ root @ random.normal(size=4), by_circles, by_grey)
        for _ in range(4000)
    ]
    assert np.mean(squared) == pytest.approx(4.0, rel=0.05)


def test_more_unknowns_take_what_a_whole_fit_with_them_takes() -> None:
    random = np.random.default_rng(1)
    base, extra = random.normal(size=(20, 5)), random.normal(size=(20, 2))
    prior = np.diag([3.0, 0.0, 0.0, 1.0, 0.0])
    root = np.linalg.cholesky(base.T @ base + prior).T
    all_columns = np.concatenate([base, extra], axis=1)
    score = score_of_residuals(extra, np.zeros(20), base, root, freedom=13.0)
    normal = all_columns.T @ all_columns
    normal[:5, :5] += prior
    np.testing.assert_allclose(np.linalg.inv(score.information), np.linalg.inv(normal)[5:, 5:])


def _images_px(circles: Adjustment) -> np.ndarray:
    """The images of the circles' centres, as an adjustment has them."""
    problem = circles.problem
    flat = type(problem.parametrization)(**{**vars(problem.parametrization), "has_circles": False})
    errors = errors_px(problem._replace(parametrization=flat))[0]
    return errors + problem.views[0].detection.centres_px


def _residuals_px(circles: Adjustment) -> np.ndarray:
    return circles.whitened.residual[0][: 2 * len(SHEET)].reshape(-1, 2) * SIGMA_PX


def moved_circles(camera: SheetCamera, shift_px: np.ndarray) -> SheetCamera:
    """The camera with its circles detected at shifted positions."""
    centres = camera.detection.centres_px + shift_px
    return dataclasses.replace(
        camera, detection=dataclasses.replace(camera.detection, centres_px=centres)
    )


def scatters(shared_px: float) -> list[float]:
    """Scatter of the blocks in 20 images whose circles share an error with those of their block."""
    block_scatters = []
    for seed in range(20):
        (camera,) = made_views(seed, cameras=("upper",)).cameras
        centres_mm = SHEET.centres_mm
        cell = np.floor((centres_mm - centres_mm.min()) / 81 * 4).astype(int)
        block = np.random.default_rng([3, seed]).normal(size=(4, 4, 2))[cell[:, 0], cell[:, 1]]
        camera = moved_circles(camera, shared_px * block)
        block_scatters.append(scatter_of_blocks(adjusted([camera]), 0))
    return block_scatters


def test_blocks_scatter_as_claimed_unless_neighbours_share_an_error() -> None:
    alone, shared = scatters(0.0), scatters(3 * SIGMA_PX)
    assert np.mean(alone) < 1.2
    assert np.mean(shared) > np.mean(alone) + 0.1


@pytest.mark.parametrize(("scatters", "method"), [(False, "pixels"), (True, "points")])
def test_grey_levels_that_differ_are_believed_where_their_places_agree_with_each_other(
    scatters: bool, method: str
) -> None:
    """All circles are off by one sigma together, as under the edge of a shadow."""
    (camera,) = made_views(0, cameras=("left",)).cameras
    circles, finer_px = adjusted([camera]), SIGMA_PX / np.sqrt(1.75)
    noise = np.random.default_rng(1).normal(scale=2.0 if scatters else 1.0, size=(len(SHEET), 2))
    points_px = _images_px(circles) + SIGMA_PX + finer_px * noise
    root = np.eye(2 * len(SHEET)) / finer_px
    shown = dataclasses.replace(
        camera, grey_level_points=SheetPoints(SHEET.centres_mm, points_px, root)
    )
    choice = choose_observations(0, shown, circles, adjusted([shown]))
    assert choice.agreement_p_value < 1e-3
    assert choice.method == method


@pytest.mark.parametrize(
    ("is_processed", "shared_px", "systematics", "method"),
    [
        (False, 0.0, TYPICAL, "pixels"),
        (True, 0.0, TYPICAL, "points"),
        (True, 3 * SIGMA_PX, TYPICAL, "pixels"),
        (True, 0.0, Systematics(aim_sigma_mm=TYPICAL.aim_sigma_mm), "pixels"),
    ],
    ids=["camera", "phone", "phone under glare", "phone, all exact"],
)
def test_grey_levels_of_sharpened_pictures_that_differ_give_way_to_sound_circles(
    is_processed: bool, shared_px: float, systematics: Systematics, method: str
) -> None:
    """Uncertain lens and sheet parameters absorb the shift of whole edges by an image filter."""
    (camera,) = made_views(0, systematics, cameras=("left",)).cameras
    smooth = np.cos(SHEET.centres_mm[:, 1:] / 15.0) * np.ones(2)
    circles, finer_px = adjusted([camera], systematics), SIGMA_PX / np.sqrt(1.75)
    noise = np.random.default_rng(1).normal(size=(len(SHEET), 2))
    points_px = _images_px(circles) + SIGMA_PX + finer_px * noise
    camera = moved_circles(camera, shared_px * smooth)
    circles = adjusted([camera], systematics)
    root = np.eye(2 * len(SHEET)) / finer_px
    points = SheetPoints(SHEET.centres_mm, points_px, root)
    picture = GreyLevelFit(points, None, None, is_processed)
    shown = dataclasses.replace(camera, grey_level_fit=picture, grey_level_points=points)
    choice = choose_observations(0, shown, circles, adjusted([shown], systematics))
    assert choice.agreement_p_value < 1e-2
    assert choice.method == method
