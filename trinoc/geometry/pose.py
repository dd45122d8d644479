"""Where a camera stands: four (or six) parameters relative to the sheet, or any rigid motion."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.geometry.rotation import (
    pan_tilt_swing_from_rotation,
    rotation_from_pan_tilt_swing,
    rotation_from_vector,
)
from trinoc.numerics import ArrayLike


class Pose(eqx.Module):
    """A rigid motion `cam_from_world` = [R | t]: x_cam = R x_world + t.

    Fields
    ------
    cam_from_world : (3, 4) rotation, and translation in mm.
    """

    cam_from_world: Float[ArrayLike, "3 4"]

    @property
    def rotation(self) -> Float[ArrayLike, "3 3"]:
        """cam_from_world rotation; its rows are the camera's x, y, z in the world frame."""
        return self.cam_from_world[:, :3]

    @property
    def centre_world_mm(self) -> Float[ArrayLike, "3"]:
        """Centre of projection in the world frame."""
        return -self.rotation.T @ self.cam_from_world[:, 3]

    def moved(self, motion: Float[ArrayLike, "6"]) -> "Pose":
        """This pose after a small motion of the camera, the chart of six-parameter updates.

        `motion` = (rotation vector in rad about the camera's axes, displacement of the centre
        in mm along the world's axes); zero leaves the pose as it is.
        """
        rotation = rotation_from_vector(motion[:3]) @ self.rotation
        centre = self.centre_world_mm + motion[3:]
        return Pose(jnp.concatenate([rotation, -(rotation @ centre)[:, None]], axis=1))


class PanTiltPose(eqx.Module):
    """The method's parameters of a camera that looks at the sheet Z = 0.

    Six numbers describe any pose whose optical axis meets the sheet in front of the camera;
    the four-parameter model holds `aim_mm` at the origin of the world.

    Fields
    ------
    pan_rad : azimuth of the camera from -Y toward +X.
    tilt_rad : elevation of the camera above Z = 0.
    swing_rad : turn of the picture's x toward its y.
    distance_mm : from the aim to the centre of projection.
    aim_mm : (2,) the point (X, Y) of Z = 0 on the optical axis.
    """

    pan_rad: Float[ArrayLike, ""]
    tilt_rad: Float[ArrayLike, ""]
    swing_rad: Float[ArrayLike, ""]
    distance_mm: Float[ArrayLike, ""]
    aim_mm: Float[ArrayLike, "2"]

    @classmethod
    def from_vector(cls, parameters: Float[ArrayLike, "6"]) -> "PanTiltPose":
        """From (pan, tilt, swing in rad, distance, aim X, aim Y in mm)."""
        return cls(parameters[0], parameters[1], parameters[2], parameters[3], parameters[4:6])

    @classmethod
    def from_pose(cls, pose: Pose) -> "PanTiltPose":
        """The parameters of a rigid motion; NaN where the axis does not meet Z = 0 in front."""
        pan, tilt, swing = pan_tilt_swing_from_rotation(pose.rotation)
        centre, forward = jnp.asarray(pose.centre_world_mm), pose.rotation[2]
        distance = -centre[2] / forward[2]
        distance = jnp.where((distance > 0) & jnp.isfinite(distance), distance, jnp.nan)
        return cls(pan, tilt, swing, distance, (centre + distance * forward)[:2])

    @property
    def vector(self) -> Float[ArrayLike, "6"]:
        """(pan, tilt, swing in rad, distance, aim X, aim Y in mm)."""
        angles = [self.pan_rad, self.tilt_rad, self.swing_rad, self.distance_mm]
        return jnp.concatenate([jnp.stack([jnp.asarray(value) for value in angles]), self.aim_mm])

    @property
    def pose(self) -> Pose:
        """The rigid motion cam_from_world."""
        rotation = rotation_from_pan_tilt_swing(self.pan_rad, self.tilt_rad, self.swing_rad)
        centre = jnp.append(self.aim_mm, 0.0) - self.distance_mm * rotation[2]
        return Pose(jnp.concatenate([rotation, -(rotation @ centre)[:, None]], axis=1))
