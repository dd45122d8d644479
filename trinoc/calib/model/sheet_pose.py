"""A camera over the sheet, in a chart without poles.

Pan and swing become one angle where a camera looks straight down, which is a good place for
a camera. So fits move a rotation, and pan, tilt and swing are read off at the end.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.geometry import pan_tilt_swing_from_rotation, rotation_from_vector
from trinoc.numerics import ArrayLike


class SheetPose(eqx.Module):
    """A pose whose optical axis meets the sheet at `aim_mm`, at `distance_mm` from the centre.

    Fields
    ------
    rotation : (3, 3) cam_from_world.
    distance_mm : from the aim to the centre of projection.
    aim_mm : (2,) the point (X, Y) of Z = 0 on the optical axis.
    """

    rotation: Float[ArrayLike, "3 3"]
    distance_mm: Float[ArrayLike, ""]
    aim_mm: Float[ArrayLike, "2"]

    def moved(self, step: Float[ArrayLike, "p"]) -> "SheetPose":
        """This pose after a step of four or six numbers; zero leaves it as it is.

        `step` = (rotation vector in rad about the camera's axes, change of distance, and for
        six the shift of the aim along X and Y, both in units of the present distance).
        """
        rotation = rotation_from_vector(step[:3]) @ self.rotation
        distance = self.distance_mm * (1 + step[3])
        aim = self.aim_mm
        if step.shape[0] == 6:
            aim = aim + self.distance_mm * step[4:6]
        return SheetPose(rotation, distance, aim)

    @property
    def translation_mm(self) -> Float[ArrayLike, "3"]:
        """t of x_cam = R x_world + t: the aim lies at (0, 0, distance) in the camera frame."""
        on_axis = jnp.zeros(3).at[2].set(self.distance_mm)
        return on_axis - self.rotation[:, :2] @ self.aim_mm

    @property
    def cam_from_sheet(self) -> Float[ArrayLike, "3 3"]:
        """Homography from (X, Y, 1) on the sheet to normalised image coordinates."""
        return jnp.stack([self.rotation[:, 0], self.rotation[:, 1], self.translation_mm], axis=1)

    @property
    def parameters(self) -> Float[ArrayLike, "6"]:
        """(pan, tilt, swing in rad, distance, aim X, aim Y in mm)."""
        pan, tilt, swing = pan_tilt_swing_from_rotation(self.rotation)
        distance = jnp.asarray(self.distance_mm)
        return jnp.concatenate([jnp.stack([pan, tilt, swing, distance]), self.aim_mm])
