"""By how much a board that is no flat sheet, or not as drawn, moves the images of its places."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric import ShiftOfPlaces
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.sheet import AbstractSheet
from trinoc.geometry import AbstractLens
from trinoc.numerics import ArrayLike, in_blocks, point_tree

# Places at a time, so that another number of them does not compile again.
_BLOCK = 8192


def shift_of_places(
    problem: Problem, lens: AbstractLens, cam_from_board: Float[np.ndarray, "3 4"]
) -> ShiftOfPlaces | None:
    """The shift of places in px, from where the lens and a flat sheet would have them; None for
    none.

    What lies about a circle moves with it.
    """
    state = jax.tree.map(np.asarray, problem.state)
    if not (np.any(state.sheet) or np.any(state.shape)):
        return None
    sheet, tree = problem.chart.sheet_model, point_tree(problem.target.centres_mm)

    def shift(places_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        aside = np.zeros((len(places_mm), 3))
        if len(state.shape):
            aside = state.shape[tree.query(places_mm)[1]]

        def block(places: np.ndarray, asides: np.ndarray) -> Float[ArrayLike, "n 2"]:
            return _shifts(lens, cam_from_board, sheet, state.sheet, places, asides)

        return np.asarray(in_blocks(block, _BLOCK, places_mm, aside))

    return shift


@jax.jit
def _shifts(
    lens: AbstractLens,
    cam_from_board: Float[ArrayLike, "3 4"],
    sheet: AbstractSheet,
    numbers: Float[ArrayLike, "w"],
    places_mm: Float[ArrayLike, "n 2"],
    aside_mm: Float[ArrayLike, "n 3"],
) -> Float[ArrayLike, "n 2"]:
    def image(point: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        return lens.project_ray(cam_from_board[:, :3] @ point + cam_from_board[:, 3])

    def shift(place: Float[ArrayLike, "2"], aside: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        flat = jnp.append(place, 0.0)
        return image(sheet.point(flat, numbers) + aside) - image(flat)

    return jax.vmap(shift)(places_mm, aside_mm)
