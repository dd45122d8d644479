"""How far aside of where a flat sheet and some lens would have them places are seen."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.places import BoardView, board_view
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.sheet import AbstractSheet
from trinoc.calib.problem.views import View
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_point
from trinoc.numerics.buckets import in_blocks
from trinoc.numerics.joins import point_tree
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

# numerical: places at a time, so that another number of them does not compile again.
_BLOCK = 8192
Shift = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2"]]


def apparent_shift(problem: Problem, view: View, flat_pose: Pose, flat_lens: AbstractLens) -> Shift:
    """From places in mm to px: as the problem has them, less as a flat sheet that is as drawn.

    flat_pose, flat_lens : of the camera before that sheet. What lies about a place of the board
    moves with it.
    """
    state, parametrization = jax.tree.map(np.asarray, (problem.state, problem.parametrization))
    here = board_view(state, parametrization, view.camera, view.shot, view.board)
    tree = point_tree(problem.target.centres_mm)

    def shift(place_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        aside_mm = np.zeros((len(place_mm), 3))
        if len(state.shape):
            aside_mm = state.shape[tree.query(place_mm)[1]]

        def of_block(places: np.ndarray, asides: np.ndarray) -> Float[ArrayLike, "n 2"]:
            return _shifts(here, parametrization.sheet_model, flat_pose, flat_lens, places, asides)

        return np.asarray(in_blocks(of_block, _BLOCK, place_mm, aside_mm))

    return shift


@kept_jit
def _shifts(
    here: BoardView,
    sheet: AbstractSheet,
    flat_pose: Pose,
    flat_lens: AbstractLens,
    place_mm: Float[ArrayLike, "n 2"],
    aside_mm: Float[ArrayLike, "n 3"],
) -> Float[ArrayLike, "n 2"]:
    def shift(place: Float[ArrayLike, "2"], aside: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        drawn = jnp.append(place, 0.0)
        return here.project(drawn, aside, sheet, 0) - project_point(flat_pose, flat_lens, drawn)

    return jax.vmap(shift)(place_mm, aside_mm)
