"""How far aside of where a flat sheet and the lens as it was said would have it a place is seen."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.estimate import Adjustment
from trinoc.calib.adjustment.sheet_shape import point_of_place
from trinoc.geometry import AbstractLens, Pose, project_point
from trinoc.numerics import ArrayLike

# Places are looked at in pieces of one length, so that another number of them compiles nothing.
_PIECE = 8192


def apparent_shift(
    adjustment: Adjustment, view: int, pose: Pose, lens: AbstractLens
) -> Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, "n 2"]]:
    """From places in mm to px: as adjusted, less as a flat sheet before `pose` and `lens`."""
    found = adjustment.adjusted
    own_pose, own_lens = jax.tree.map(lambda leaf: leaf[view], (found.pose, found.lens))
    known = (own_pose, own_lens, found.shape, adjustment.reach_mm, pose, lens)

    def shift(place_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        count = len(place_mm)
        padded = np.concatenate([place_mm, np.zeros((-count % _PIECE, 2))])
        pieces = [_shifts(*known, padded[k : k + _PIECE]) for k in range(0, len(padded), _PIECE)]
        return np.concatenate([np.asarray(piece) for piece in pieces])[:count]

    return shift


@jax.jit
def _shifts(
    pose: Pose,
    lens: AbstractLens,
    shape: Float[ArrayLike, "s"],
    reach_mm: Float[ArrayLike, ""],
    flat_pose: Pose,
    said_lens: AbstractLens,
    places_mm: Float[ArrayLike, "n 2"],
) -> Float[ArrayLike, "n 2"]:
    def one(place: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        there = project_point(pose, lens, point_of_place(place, shape, reach_mm))
        return there - project_point(flat_pose, said_lens, jnp.append(place, 0.0))

    return jax.vmap(one)(places_mm)
