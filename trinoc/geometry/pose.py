"""Pose of a camera: a rigid motion, its parameters over the sheet, and small steps for fits."""

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
    """Choice of the pose parameters that a fit estimates. The value is the tuple of their names.

    Attributes
    ----------
    AIMED :
        Pan, tilt, swing and distance. The aim, which is the intersection of the optical axis with
        the sheet Z = 0, is fixed.
    AIM_FREE :
        Pan, tilt, swing, distance and aim: any pose whose optical axis meets the sheet.
    RIGID :
        Any rigid motion: a rotation and a displacement relative to the initial pose.

    Notes
    -----
    The first three parameters of each model are angles.
    """

    AIMED = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
    AIM_FREE = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm", "aim_x_mm", "aim_y_mm")
    RIGID = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "centre_x_mm", "centre_y_mm", "centre_z_mm")

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the pose parameters of one camera, with units."""
        return self.value

    @property
    def size(self) -> int:
        """Number of pose parameters that a fit estimates."""
        return len(self.value)

    @property
    def option_name(self) -> str:
        """Name of the model in options and arguments: "aimed", "aim-free" or "rigid"."""
        return self.name.lower().replace("_", "-")

    @classmethod
    def of(cls, value: "PoseModel | str") -> "PoseModel":
        """Convert an option name to a PoseModel; a PoseModel is returned unchanged.

        Raise `InputError` for any other value.
        """
        for model in cls:
            if value is model or value == model.option_name:
                return model
        option_names = ", ".join(f'"{model.option_name}"' for model in cls)
        raise InputError(
            f"pose_model is {value!r}, but must be one of {option_names}, or a PoseModel."
        )


def pose_model_over_sheet(pose_model: PoseModel | str) -> PoseModel:
    """Convert an option name to a PoseModel with an aim: AIMED or AIM_FREE.

    Raise `InputError` for RIGID, which a calibration over a sheet cannot use, and for unknown
    names.
    """
    model = PoseModel.of(pose_model)
    if model is PoseModel.RIGID:
        raise InputError(
            'pose_model is "rigid", but a calibration over the sheet needs a model with an aim. '
            'Give "aim-free", which allows any pose that looks at the sheet.'
        )
    return model


class Pose(Value):
    """A rigid motion `cam_from_world` = [R | t]: x_cam = R x_world + t.

    Attributes
    ----------
    cam_from_world : (3, 4)
        Rotation, and translation in mm.

    Notes
    -----
    A fit changes a pose by small steps in local coordinates (`retract`), which have no singularity.
    Pan and swing have one: for a camera that looks straight down they are one angle. A fit
    therefore computes pan, tilt, swing and distance at the end (`parameters`,
    `d_parameters_d_delta`).
    """

    cam_from_world: Float[ArrayLike, "3 4"]

    @classmethod
    def from_centre(
        cls, rotation: Float[ArrayLike, "3 3"], centre_world_mm: Float[ArrayLike, "3"]
    ) -> "Pose":
        """Pose from the rotation cam_from_world and the centre of projection in the world, mm."""
        return cls.from_translation(rotation, -(rotation @ centre_world_mm))

    @classmethod
    def from_aim(
        cls,
        rotation: Float[ArrayLike, "3 3"],
        distance_mm: Float[ArrayLike, ""],
        aim_mm: Float[ArrayLike, "2"],
    ) -> "Pose":
        """Pose from the rotation cam_from_world and the aim on the sheet Z = 0.

        The aim is the point (X, Y, 0) on the optical axis, `distance_mm` in front of the camera.
        """
        zero = jnp.zeros_like(distance_mm)
        aim_cam = jnp.stack([zero, zero, jnp.asarray(distance_mm)])
        return cls.from_translation(rotation, aim_cam - rotation[:, :2] @ aim_mm)

    @classmethod
    def from_translation(
        cls, rotation: Float[ArrayLike, "3 3"], translation_mm: Float[ArrayLike, "3"]
    ) -> "Pose":
        """Pose from the rotation R and the translation t of x_cam = R x_world + t."""
        # NumPy in, NumPy out: searches over many poses are faster without JAX.
        xp = array_namespace(rotation, translation_mm)
        return cls(xp.concatenate([rotation, translation_mm[:, None]], axis=1))

    @classmethod
    def from_parameters(cls, parameters: Float[ArrayLike, "6"]) -> "Pose":
        """Pose from (pan, tilt, swing, distance, aim X, aim Y), in rad and mm."""
        xp = array_namespace(parameters)
        pan, tilt, swing, distance = (parameters[k] for k in range(4))
        rotation = rotation_from_pan_tilt_swing(pan, tilt, swing)
        centre = xp.concatenate([parameters[4:6], xp.zeros_like(parameters[:1])])
        return cls.from_centre(rotation, centre - distance * rotation[2])

    @property
    def rotation(self) -> Float[ArrayLike, "3 3"]:
        """Rotation cam_from_world (3, 3); its rows are the camera's x, y, z axes in the world."""
        return self.cam_from_world[:, :3]

    @property
    def translation_mm(self) -> Float[ArrayLike, "3"]:
        """Translation t of x_cam = R x_world + t: the world origin in the camera frame, (3,) mm."""
        return self.cam_from_world[:, 3]

    @property
    def centre_world_mm(self) -> Float[ArrayLike, "3"]:
        """Centre of projection in the world frame, (3,) mm."""
        return -self.rotation.T @ self.translation_mm

    @property
    def distance_mm(self) -> Float[ArrayLike, ""]:
        """Distance from the centre of projection along the optical axis to the sheet Z = 0.

        Negative if the intersection is behind the camera; infinite if the axis is parallel to the
        sheet.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return -self.centre_world_mm[2] / self.rotation[2, 2]

    @property
    def aim_mm(self) -> Float[ArrayLike, "2"]:
        """Intersection (X, Y) of the optical axis with the sheet Z = 0, (2,) mm."""
        return (self.centre_world_mm + self.distance_mm * self.rotation[2])[:2]

    @property
    def cam_from_sheet(self) -> Float[ArrayLike, "3 3"]:
        """Matrix (3, 3) from (X, Y, 1) on the sheet Z = 0 to the camera frame, mm."""
        rotation = self.rotation
        return jnp.stack([rotation[:, 0], rotation[:, 1], self.translation_mm], axis=1)

    @property
    def parameters(self) -> Float[ArrayLike, "6"]:
        """Pose parameters (pan, tilt, swing, distance, aim X, aim Y), (6,), in rad and mm.

        Distance and aim are NaN if the optical axis does not meet Z = 0 in front of the camera.
        """
        xp = array_namespace(self.cam_from_world)
        pan, tilt, swing = pan_tilt_swing_from_rotation(self.rotation)
        distance = xp.asarray(self.distance_mm)
        distance = xp.where((distance > 0) & xp.isfinite(distance), distance, xp.nan)
        aim = (self.centre_world_mm + distance * self.rotation[2])[:2]
        return xp.concatenate([xp.stack([pan, tilt, swing, distance]), aim])

    @property
    def inverse(self) -> "Pose":
        """The inverse rigid motion, world_from_cam."""
        return Pose.from_translation(self.rotation.T, self.centre_world_mm)

    def __matmul__(self, first: "Pose") -> "Pose":
        """Composition a_from_c = a_from_b @ b_from_c: the argument `first` is applied first."""
        moved = self.rotation @ first.translation_mm + self.translation_mm
        return Pose.from_translation(self.rotation @ first.rotation, moved)

    def transform(self, point_world_mm: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3"]:
        """Convert one world point to the camera frame, (3,) mm."""
        return self.rotation @ point_world_mm + self.translation_mm

    def transform_points(
        self, points_world_mm: Float[ArrayLike, "*n 3"]
    ) -> Float[ArrayLike, "*n 3"]:
        """Convert world points to the camera frame, (..., 3) mm."""
        return points_world_mm @ self.rotation.T + self.translation_mm

    def aim_at_origin(self) -> "Pose":
        """Rotate the camera by the smallest angle that puts the world origin on its optical axis.

        The origin must lie in front of the camera.
        """
        distance = jnp.sqrt(self.translation_mm @ self.translation_mm)
        rotation = _turn_to_axis(self.translation_mm / distance) @ self.rotation
        return Pose.from_aim(rotation, distance, jnp.zeros_like(rotation[0, :2]))

    def retract(
        self, delta: Float[ArrayLike, "p"], model: PoseModel, unit_mm: ScalarLike
    ) -> "Pose":
        """Return this pose after a small step `delta`; a zero step returns an equal pose.

        Parameters
        ----------
        delta : (p,)
            Local coordinates of the step. The first three are a rotation vector in rad about the
            camera axes (`cayley_rotation`). The rest are lengths in units of `unit_mm`. AIMED:
            change of the distance. AIM_FREE: changes of the distance and of the aim's X and Y.
            RIGID: displacement of the centre along the world axes.
        model : PoseModel
            The pose model, which determines the number p of coordinates.
        unit_mm : float
            Length unit, for example the working distance, so that all entries of `delta` have
            similar size.
        """
        rotation = cayley_rotation(delta[:3]) @ self.rotation
        if model is PoseModel.RIGID:
            return Pose.from_centre(rotation, self.centre_world_mm + unit_mm * delta[3:6])
        aim = self.aim_mm
        if model is PoseModel.AIM_FREE:
            aim = aim + unit_mm * delta[4:6]
        return Pose.from_aim(rotation, self.distance_mm + unit_mm * delta[3], aim)

    def model_parameters(self, model: PoseModel, origin: "Pose") -> Float[ArrayLike, "p"]:
        """Values (p,) of the parameters of a pose model, in rad and mm.

        RIGID parameters are relative to the pose `origin`; the other models ignore `origin`.
        """
        if model is not PoseModel.RIGID:
            return self.parameters[: model.size]
        turn = vector_from_rotation(self.rotation @ origin.rotation.T)
        return jnp.concatenate([turn, self.centre_world_mm - origin.centre_world_mm])

    def d_parameters_d_delta(
        self, model: PoseModel, unit_mm: ScalarLike, origin: "Pose"
    ) -> Float[ArrayLike, "p p"]:
        """Derivative of `model_parameters` with respect to the step `delta` of `retract`, (p, p).

        It is computed at this pose, for a step of 0.
        """
        return jax.jacfwd(
            lambda delta: self.retract(delta, model, unit_mm).model_parameters(model, origin)
        )(jnp.zeros(model.size, jnp.asarray(self.cam_from_world).dtype))


def _turn_to_axis(ray: Float[ArrayLike, "3"]) -> Float[ArrayLike, "3 3"]:
    """Smallest rotation (3, 3) that maps a unit vector with z > 0 onto (0, 0, 1)."""
    x, y, z = ray[0], ray[1], ray[2]
    factor = 1 / (1 + z)
    rows = [
        [1 - factor * x * x, -factor * x * y, -x],
        [-factor * x * y, 1 - factor * y * y, -y],
        [x, y, z],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])
