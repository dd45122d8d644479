"""Following the goals shows the whole board, adds information each time and ends."""

import numpy as np
import pytest

from tests.capture.made import quality
from trinoc.capture.advice import ENOUGH_FIELD, LEAN, adds_information, field_share, next_goal
from trinoc.capture.goal import Goal, goal_outline_px, goal_points_px
from trinoc.capture.measures import measure_lean


def grid_mm(rows: int, columns: int) -> np.ndarray:
    across, up = np.meshgrid(np.arange(columns), np.arange(rows)[::-1])
    return 20.0 * np.stack([across, up], axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("grid", [(5, 7), (8, 8), (4, 5), (11, 7)])
@pytest.mark.parametrize("size_px", [(640, 480), (1920, 1080), (480, 640)])
def test_who_follows_the_goals_shows_something_new_each_time_until_it_is_enough(
    grid: tuple[int, int], size_px: tuple[int, int]
) -> None:
    points_mm, shown = grid_mm(*grid), []
    while (goal := next_goal(shown)) is not None:
        positions_px = goal_points_px(goal, points_mm, size_px)
        pitch_px = np.linalg.norm(positions_px[1] - positions_px[0])
        # With its outer squares, which a chessboard must show.
        assert (positions_px > 0.9 * pitch_px * (goal.lean == (0.0, 0.0)) - 1).all()
        assert (positions_px < np.array(size_px) - 0.9 * pitch_px * (goal.lean == (0.0, 0.0))).all()
        now = quality(
            positions_px,
            measure_lean(points_mm, positions_px),
            points_mm=points_mm,
            size_px=size_px,
        )
        assert adds_information(shown, now) or "more" in goal.sentence
        shown.append(now)
        assert len(shown) < 70
    assert field_share(shown) >= ENOUGH_FIELD
    assert len(shown) >= 6


@pytest.mark.parametrize("lean", [(0.2, 0.0), (-0.2, 0.0), (0.0, 0.2), (0.0, -0.2)])
def test_what_is_drawn_leans_as_is_said(lean: tuple[float, float]) -> None:
    points_mm = grid_mm(5, 7)
    measured_lean = measure_lean(
        points_mm, goal_points_px(Goal("", lean=lean), points_mm, (640, 480))
    )
    np.testing.assert_allclose(measured_lean, lean, atol=0.4 * LEAN)


def test_the_outline_is_the_frame_of_the_places() -> None:
    points_mm, goal = grid_mm(5, 7), Goal("", (0.2, 0.8), 0.4, turn_deg=30.0)
    positions_px = goal_points_px(goal, points_mm, (640, 480))
    corners = positions_px[[0, 6, 34, 28]]
    np.testing.assert_allclose(goal_outline_px(goal, points_mm, (640, 480)), corners, atol=1e-9)
