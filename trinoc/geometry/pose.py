"""Where a camera stands: a rigid motion, its parameters over the sheet, and small steps of those
that are free."""

from enum import Enum

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry.rotation import (
    cayley_rotation,
    pan_tilt_swing_from_rotation,
    rotation_from_pan_tilt_swing,
    vector_from_rotation,
)
from trinoc.numerics.precision import ArrayLike, ScalarLike, array_namespace
from trinoc.numerics.values import Value


class PoseModel(Enum):
    """What a fit may change of a camera's pose, with the names of the parameters.

    AIMED : pan, tilt, swing and distance; the point of the sheet that the optical axis meets is
        held, at the origin unless something else is said.
    AIM_FREE : these and the aim, so any pose whose axis meets the sheet Z = 0.
    RIGID : any rigid motion, as a rotation and a displacement from where the camera was.

    The angles come first in each, and there are three of them.
    """

    AIMED = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
    AIM_FREE = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm", "aim_x_mm", "aim_y_mm")
    RIGID = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "centre_x_mm", "centre_y_mm", "centre_z_mm")

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names, with units, of the parameters of one camera."""
        return self.value

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.value)

    @property
    def word(self) -> str:
        """The model as options spell it: "aimed", "aim-free" or "rigid"."""
        return self.name.lower().replace("_", "-")

    @classmethod
    def of(cls, given: "PoseModel | str") -> "PoseModel":
        """A model from itself or its word. Raises InputError for anything else."""
        for model in cls:
            if given is model or given == model.word:
                return model
        words = ", ".join(f'"{model.word}"' for model in cls)
        raise InputError(f"pose_model is {given!r}, but must be one of {words}, or a PoseModel.")


def pose_model_over_sheet(pose_model: PoseModel | str) -> PoseModel:
    """The model of cameras that a sheet places. Raises InputError for RIGID and for no model."""
    model = PoseModel.of(pose_model)
    if model is PoseModel.RIGID:
        raise InputError(
            'pose_model is "rigid", but a camera over the sheet is described by its aim: give '
            '"aim-free", which is any pose that looks at the sheet.'
        )
    return model


class Pose(Value):
    """A rigid motion `cam_from_world` = [R | t]: x_cam = R x_world + t.

    Fits take small steps from a pose (`retract`), in local coordinates that have no pole: pan and
    swing become one angle where a camera looks straight down, which is a good place for a camera.
    The method's parameters are read off at the end (`parameters`, `d_parameters_d_delta`).

    Fields
    ------
    cam_from_world : (3, 4) rotation, and translation in mm.
    """

    cam_from_world: Float[ArrayLike, "3 4"]

    @classmethod
    def from_centre(
        cls, rotation: Float[ArrayLike, "3 3"], centre_world_mm: Float[ArrayLike, "3"]
    ) -> "Pose":
        """From the cam_from_world rotation and the centre of projection in the world."""
        return cls.from_translation(rotation, -(rotation @ centre_world_mm))

    @classmethod
    def from_aim(
        cls,
        rotation: Float[ArrayLike, "3 3"],
        distance_mm: Float[ArrayLike, ""],
        aim_mm: Float[ArrayLike, "2"],
    ) -> "Pose":
        """From the rotation, and the point (X, Y) of Z = 0 at `distance_mm` on the optical axis."""
        zero = jnp.zeros_like(distance_mm)
        aim_cam = jnp.stack([zero, zero, jnp.asarray(distance_mm)])
        return cls.from_translation(rotation, aim_cam - rotation[:, :2] @ aim_mm)

    @classmethod
    def from_translation(
        cls, rotation: Float[ArrayLike, "3 3"], translation_mm: Float[ArrayLike, "3"]
    ) -> "Pose":
        """From R and t of x_cam = R x_world + t."""
        # Searches among many poses are fast in NumPy.
        xp = array_namespace(rotation, translation_mm)
        return cls(xp.concatenate([rotation, translation_mm[:, None]], axis=1))

    @classmethod
    def from_parameters(cls, parameters: Float[ArrayLike, "6"]) -> "Pose":
        """From (pan, tilt, swing in rad, distance, aim X, aim Y in mm)."""
        xp = array_namespace(parameters)
        pan, tilt, swing, distance = (parameters[k] for k in range(4))
        rotation = rotation_from_pan_tilt_swing(pan, tilt, swing)
        centre = xp.concatenate([parameters[4:6], xp.zeros_like(parameters[:1])])
        return cls.from_centre(rotation, centre - distance * rotation[2])

    @property
    def rotation(self) -> Float[ArrayLike, "3 3"]:
        """cam_from_world rotation; its rows are the camera's x, y, z in the world frame."""
        return self.cam_from_world[:, :3]

    @property
    def translation_mm(self) -> Float[ArrayLike, "3"]:
        """t of x_cam = R x_world + t: the world's origin in the camera frame."""
        return self.cam_from_world[:, 3]

    @property
    def centre_world_mm(self) -> Float[ArrayLike, "3"]:
        """Centre of projection in the world frame."""
        return -self.rotation.T @ self.translation_mm

    @property
    def distance_mm(self) -> Float[ArrayLike, ""]:
        """From the centre along the optical axis to Z = 0; negative where that lies behind, and
        infinite where they are parallel."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return -self.centre_world_mm[2] / self.rotation[2, 2]

    @property
    def aim_mm(self) -> Float[ArrayLike, "2"]:
        """The point (X, Y) of Z = 0 on the optical axis."""
        return (self.centre_world_mm + self.distance_mm * self.rotation[2])[:2]

    @property
    def cam_from_sheet(self) -> Float[ArrayLike, "3 3"]:
        """Homography from (X, Y, 1) on the sheet Z = 0 to the camera frame."""
        rotation = self.rotation
        return jnp.stack([rotation[:, 0], rotation[:, 1], self.translation_mm], axis=1)

    @property
    def parameters(self) -> Float[ArrayLike, "6"]:
        """(pan, tilt, swing in rad, distance, aim X, aim Y in mm).

        Distance and aim are NaN where the axis does not meet Z = 0 in front of the camera.
        """
        xp = array_namespace(self.cam_from_world)
        pan, tilt, swing = pan_tilt_swing_from_rotation(self.rotation)
        distance = xp.asarray(self.distance_mm)
        distance = xp.where((distance > 0) & xp.isfinite(distance), distance, xp.nan)
        aim = (self.centre_world_mm + distance * self.rotation[2])[:2]
        return xp.concatenate([xp.stack([pan, tilt, swing, distance]), aim])

    @property
    def inverse(self) -> "Pose":
        """The way back: world_from_cam."""
        return Pose.from_translation(self.rotation.T, self.centre_world_mm)

    def __matmul__(self, first: "Pose") -> "Pose":
        """`first`, then this one: a_from_c = a_from_b @ b_from_c."""
        moved = self.rotation @ first.translation_mm + self.translation_mm
        return Pose.from_translation(self.rotation @ first.rotation, moved)

    def transform(self, point_world_mm: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3"]:
        """A point of the world in the camera frame."""
        return self.rotation @ point_world_mm + self.translation_mm

    def transform_points(
        self, points_world_mm: Float[ArrayLike, "*n 3"]
    ) -> Float[ArrayLike, "*n 3"]:
        """Points of the world in the camera frame."""
        return points_world_mm @ self.rotation.T + self.translation_mm

    def aim_at_origin(self) -> "Pose":
        """This pose turned until the optical axis meets the world's origin, which lies in front."""
        distance = jnp.sqrt(self.translation_mm @ self.translation_mm)
        rotation = _turn_to_axis(self.translation_mm / distance) @ self.rotation
        return Pose.from_aim(rotation, distance, jnp.zeros_like(rotation[0, :2]))

    def retract(
        self, delta: Float[ArrayLike, "p"], model: PoseModel, unit_mm: ScalarLike
    ) -> "Pose":
        """This pose after a small step; zero leaves it as it is.

        delta : (p,) a turn in rad about the camera's axes (`cayley_rotation`), then in units of
            `unit_mm` the change of distance (AIMED), this and the shift of the aim along X and Y
            (AIM_FREE), or the displacement of the centre along the world's axes (RIGID).
        unit_mm : such as the distance at which the camera works, so that all of `delta` is of one
            scale.
        """
        rotation = cayley_rotation(delta[:3]) @ self.rotation
        if model is PoseModel.RIGID:
            return Pose.from_centre(rotation, self.centre_world_mm + unit_mm * delta[3:6])
        aim = self.aim_mm
        if model is PoseModel.AIM_FREE:
            aim = aim + unit_mm * delta[4:6]
        return Pose.from_aim(rotation, self.distance_mm + unit_mm * delta[3], aim)

    def model_parameters(self, model: PoseModel, origin: "Pose") -> Float[ArrayLike, "p"]:
        """The parameters that `model` names, in rad and mm; those of RIGID count from `origin`."""
        if model is not PoseModel.RIGID:
            return self.parameters[: model.size]
        turn = vector_from_rotation(self.rotation @ origin.rotation.T)
        return jnp.concatenate([turn, self.centre_world_mm - origin.centre_world_mm])

    def d_parameters_d_delta(
        self, model: PoseModel, unit_mm: ScalarLike, origin: "Pose"
    ) -> Float[ArrayLike, "p p"]:
        """Jacobian of `model_parameters` with respect to a step of `retract` from here."""
        return jax.jacfwd(
            lambda delta: self.retract(delta, model, unit_mm).model_parameters(model, origin)
        )(jnp.zeros(model.size, jnp.asarray(self.cam_from_world).dtype))


def _turn_to_axis(ray: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3 3"]:
    """The smallest rotation that takes a unit vector with z > 0 onto the optical axis."""
    x, y, z = ray[0], ray[1], ray[2]
    factor = 1 / (1 + z)
    rows = [
        [1 - factor * x * x, -factor * x * y, -x],
        [-factor * x * y, 1 - factor * y * y, -y],
        [x, y, z],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])
