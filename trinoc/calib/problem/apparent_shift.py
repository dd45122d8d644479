"""Pixel shift of points on a bent board, relative to a flat board as drawn."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.reprojection import BoardProjection, board_projection
from trinoc.calib.problem.sheet import AbstractSheet
from trinoc.calib.problem.views import BoardObservation
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_point
from trinoc.numerics.buckets import in_blocks
from trinoc.numerics.joins import point_tree
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

# numerical: points per call, so that another number of points does not compile again.
_BLOCK = 8192
Shift = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2"]]


def apparent_shift(
    problem: Problem, view: BoardObservation, flat_pose: Pose, flat_lens: AbstractLens
) -> Shift:
    """Return a function that computes the pixel shift of points on the sheet.

    The shift is the pixel predicted by `problem`, with its bent board and its lens, minus the pixel
    predicted for a flat board as drawn. The returned function takes points of the drawing, (n, 2)
    in mm, and returns their shifts, (n, 2) in px. Each point gets the displacement of the nearest
    board point.

    Parameters
    ----------
    problem : solved problem.
    view : observation; determines the camera and the shot.
    flat_pose : pose of the camera relative to the flat sheet, for the second prediction.
    flat_lens : lens for the second prediction.
    """
    state, parametrization = jax.tree.map(np.asarray, (problem.state, problem.parametrization))
    projection = board_projection(state, parametrization, view.camera, view.shot, view.board)
    tree = point_tree(problem.target.centres_mm)

    def shift(point_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        displacement_mm = np.zeros((len(point_mm), 3))
        if len(state.shape):
            displacement_mm = state.shape[tree.query(point_mm)[1]]

        def of_block(points: np.ndarray, displacements: np.ndarray) -> Float[ArrayLike, "n 2"]:
            return _shifts(
                projection, parametrization.sheet_model, flat_pose, flat_lens, points, displacements
            )

        return np.asarray(in_blocks(of_block, _BLOCK, point_mm, displacement_mm))

    return shift


@kept_jit
def _shifts(
    projection: BoardProjection,
    sheet: AbstractSheet,
    flat_pose: Pose,
    flat_lens: AbstractLens,
    point_mm: Float[ArrayLike, "n 2"],
    displacement_mm: Float[ArrayLike, "n 3"],
) -> Float[ArrayLike, "n 2"]:
    def shift(
        point: Float[ArrayLike, "2"], displacement: Float[ArrayLike, "3"]
    ) -> Float[ArrayLike, "2"]:
        drawn = jnp.append(point, 0.0)
        return projection.project(drawn, displacement, sheet, 0) - project_point(
            flat_pose, flat_lens, drawn
        )

    return jax.vmap(shift)(point_mm, displacement_mm)
