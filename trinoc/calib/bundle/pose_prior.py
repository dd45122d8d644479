"""What the sheet's pictures said about the cameras, as a quadratic in their parameters.

The estimate of the sheet's own fit and its covariance hold all that its pictures say, to
second order about the estimate, the systematic errors shared by cameras included.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.model import CameraState
from trinoc.numerics import ArrayLike

ANGLES = 3


class PosePrior(NamedTuple):
    """Cost (x - x0)^T L (x - x0) of the public parameters x (degrees, mm, px).

    Fields
    ------
    values : (v, p) x0.
    information : (k, k) L, the inverse of the covariance of x0; zeros for no prior.
    start : the cameras from which small motions are counted.
    """

    values: Float[ArrayLike, "v p"]
    information: Float[ArrayLike, "k k"]
    start: CameraState

    def difference(self, cameras: CameraState) -> Float[ArrayLike, "k"]:
        """x - x0, with angles taken modulo a full turn."""
        values = jax.vmap(lambda camera, start: camera.parameters(start))(cameras, self.start)
        difference = values - self.values
        turns = (difference[:, :ANGLES] + 180) % 360 - 180
        return difference.at[:, :ANGLES].set(turns).reshape(-1)

    def cost(self, cameras: CameraState) -> Float[ArrayLike, ""]:
        """Squared Mahalanobis distance of the cameras from the sheet's estimate."""
        difference = self.difference(cameras)
        return difference @ self.information @ difference

    def normal_equations(
        self, cameras: CameraState
    ) -> tuple[Float[ArrayLike, "k k"], Float[ArrayLike, "k"]]:
        """(information, gradient) by the step of the cameras."""
        by_step = d_parameters_d_delta(cameras, self.start)
        weighted = by_step.T @ self.information
        return weighted @ by_step, weighted @ self.difference(cameras)


def d_parameters_d_delta(cameras: CameraState, start: CameraState) -> Float[ArrayLike, "k k"]:
    """Block-diagonal Jacobian of all public parameters by all cameras' steps."""
    blocks = jax.vmap(lambda camera, origin: camera.d_parameters_d_delta(origin))(cameras, start)
    views, size, _ = blocks.shape
    view = jnp.arange(views)
    full = jnp.zeros((views, size, views, size)).at[view, :, view, :].set(blocks)
    return full.reshape(views * size, views * size)
