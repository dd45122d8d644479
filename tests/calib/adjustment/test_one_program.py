"""One compiled program fits circles and grey levels, because their tables have one shape."""

from dataclasses import replace

import jax
import numpy as np

from tests.calib.adjustment.made_views import SHEET, TYPICAL, made_views
from trinoc.calib.adjustment.adjustment import adjust
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors, sheet_problem
from trinoc.calib.problem.views import SheetPoints, observation_table
from trinoc.geometry.pose import PoseModel

PICTURE = np.zeros((4, 4))
PRIORS = SheetPriors(PoseModel.AIMED, TYPICAL)


def problem_of(*cameras: SheetCamera) -> Problem:
    return sheet_problem(cameras, SHEET, PRIORS)


def shown(camera: SheetCamera, pieces: int) -> SheetCamera:
    """The camera with grey-level points of all circles of the sheet and of pieces of lines."""
    points_mm = np.concatenate([SHEET.centres_mm, np.zeros((pieces, 2))])
    return replace(
        camera,
        grey_level_points=SheetPoints(
            points_mm, np.zeros_like(points_mm), np.eye(2 * len(points_mm))
        ),
    )


def test_circles_and_what_the_picture_shows_have_tables_of_one_shape():
    camera = replace(made_views(0).cameras[0], image=PICTURE)
    tables = [
        observation_table(problem_of(each).views, SHEET)
        for each in (camera, shown(camera, 0), shown(camera, 32))
    ]
    shapes = [jax.tree.map(np.shape, table) for table in tables]
    assert shapes[0] == shapes[1] == shapes[2]
    alone = observation_table(problem_of(replace(camera, image=None)).views, SHEET)
    assert np.size(alone.whitening) < np.size(tables[0].whitening) / 10


def test_room_for_a_picture_changes_no_answer():
    cameras = made_views(1).cameras
    plain, roomy = (
        adjust(each, SHEET, PRIORS)
        for each in (cameras, [replace(camera, image=PICTURE) for camera in cameras])
    )
    for view in range(len(cameras)):
        rows, by_step = plain.rows(view), plain.degrees_by_step(view)
        sigma = np.sqrt(np.diag(by_step @ plain.covariance[np.ix_(rows, rows)] @ by_step.T))
        sigma[:3] = np.radians(sigma[:3])
        # The difference by rounding and the stopping rule is far below the noise.
        off = np.abs(roomy.parameters(view) - plain.parameters(view))
        np.testing.assert_array_less(off, 1e-6 * sigma)
    np.testing.assert_allclose(roomy.covariance, plain.covariance, rtol=1e-6, atol=1e-15)
