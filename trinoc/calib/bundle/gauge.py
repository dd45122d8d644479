"""What segments alone cannot say: where the rig stands, how it is turned, and its scale."""

import contextlib
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.model import CameraState
from trinoc.geometry import Pose, PoseModel
from trinoc.numerics import ArrayLike

# Share of the largest eigenvalue of the unit-diagonal information below which a direction is
# free: rounding leaves 1e-13 or so, and anything real stays far above.
FREE_EIGENVALUE = 1e-10
RIGID_GAUGE = "position, orientation and scale of the whole rig"
AIMED_GAUGE = "orientation and scale of the whole rig"


class Determined(NamedTuple):
    """Rank and covariance of the cameras' steps, and the name of what is free.

    The covariance is that on the determined directions (the pseudo-inverse in scaled
    coordinates): the inner constraints of a free network, no datum being preferred.
    """

    rank: int
    covariance: Float[np.ndarray, "k k"]
    gauge: str


def determined_part(
    information: Float[np.ndarray, "k k"], sheet_information: Float[np.ndarray, "k k"]
) -> Determined:
    """Rank, covariance and gauge of the reduced information of all cameras' steps.

    sheet_information : what of it is the sheet's. Its weak directions (a lens and a distance that
    err together) are no gauge, so that directions are compared in its own units.
    """
    units = _units(information, sheet_information)
    within = units.T @ information @ units
    scale = _positive_root(np.diag(within))
    values, vectors = np.linalg.eigh(within / scale[:, None] / scale[None, :])
    kept = values > FREE_EIGENVALUE * values[-1]
    by_direction = (units / scale) @ vectors[:, kept]
    free = int((~kept).sum())
    gauge = {0: "", 4: AIMED_GAUGE, 7: RIGID_GAUGE}.get(free, f"{free} directions of the cameras")
    return Determined(int(kept.sum()), (by_direction / values[kept]) @ by_direction.T, gauge)


def _units(
    information: Float[np.ndarray, "k k"], sheet_information: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, "k k"]:
    """Steps of one sigma of the sheet, where it speaks; else steps that are independent."""
    units = np.diag(1 / _positive_root(np.diag(information)))
    known = np.flatnonzero(np.diag(sheet_information) > 0)
    if len(known):
        scale = np.sqrt(np.diag(sheet_information)[known])
        own = sheet_information[np.ix_(known, known)] / np.outer(scale, scale)
        with contextlib.suppress(np.linalg.LinAlgError):
            units[np.ix_(known, known)] = np.linalg.inv(np.linalg.cholesky(own)).T / scale[:, None]
    return units


def _positive_root(diagonal: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
    """A direction of which nothing is known at all must not divide by nothing."""
    return np.sqrt(np.maximum(diagonal, 1e-30 * diagonal.max() or 1.0))


def with_scale_of(
    cameras: CameraState, lines_mm: Float[ArrayLike, "t 2 3"], start: CameraState
) -> tuple[CameraState, Float[ArrayLike, "t 2 3"]]:
    """Rig and lines scaled so that the centres spread as they did at the start.

    Without a sheet nothing measures the scale: it stays as it was, exactly. Cameras that aim
    at the origin still do so.
    """
    centres = _centres_mm(cameras)
    spread = _spread(_centres_mm(start)) / _spread(centres)
    origin = jnp.mean(centres, axis=0)[None, :]
    if cameras.pose_model is PoseModel.AIMED:
        origin = jnp.zeros_like(origin)
    poses = jax.vmap(lambda pose, centre: Pose.from_centre(pose.rotation, centre))(
        cameras.pose, origin + spread * (centres - origin)
    )
    scaled = eqx.tree_at(lambda state: state.pose, cameras, poses)
    return scaled, jax.vmap(lambda line: origin + spread * (line - origin))(lines_mm)


def _centres_mm(cameras: CameraState) -> Float[ArrayLike, "v 3"]:
    return jax.vmap(lambda camera: camera.pose.centre_world_mm)(cameras)


def _spread(centres_mm: Float[ArrayLike, "v 3"]) -> Float[ArrayLike, ""]:
    offset = centres_mm - jnp.mean(centres_mm, axis=0)[None, :]
    return jnp.sqrt(jnp.sum(offset * offset))
