"""A camera while it is being refined: bare arrays, and the small steps that move it."""

from enum import Enum

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.model.lens import LensArrays, lens_arrays
from trinoc.geometry import Camera, Pose, pan_tilt_swing_from_rotation, rotation_from_vector
from trinoc.numerics import ArrayLike

# A step of one in focal length doubles it; in the principal point it is this many pixels.
PRINCIPAL_POINT_STEP_PX = 1000.0


class Freedom(Enum):
    """What refinement may move in each camera.

    FOUR and SIX are the parameters of a camera over the sheet, without and with its aim.
    POSE is any rigid motion, for cameras that need not look at a sheet.
    """

    FOUR = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
    SIX = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm", "aim_x_mm", "aim_y_mm")
    POSE = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "centre_x_mm", "centre_y_mm", "centre_z_mm")


INTRINSIC_NAMES = ("focal_length_u_px", "focal_length_v_px", "principal_u_px", "principal_v_px")


class CameraState(eqx.Module):
    """One camera in arrays, so that all cameras of a rig, and many rigs, go through one `vmap`.

    Fields
    ------
    rotation : (3, 3) cam_from_world.
    centre_mm : (3,) centre of projection in the world frame.
    lens : calibration matrix and distortion.
    reach_mm : unit of length of a step: the distance at which the camera works.
    freedom : which parameters a step moves.
    with_intrinsics : whether a step moves focal lengths and principal point too.
    """

    rotation: Float[ArrayLike, "3 3"]
    centre_mm: Float[ArrayLike, "3"]
    lens: LensArrays
    reach_mm: Float[ArrayLike, ""]
    freedom: Freedom = eqx.field(static=True)
    with_intrinsics: bool = eqx.field(static=True)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the public parameters, in the order of `parameters`."""
        return self.freedom.value + (INTRINSIC_NAMES if self.with_intrinsics else ())

    @property
    def matrix_px(self) -> Float[ArrayLike, "3 4"]:
        """K [R | t] of undistorted pixels."""
        translation = -self.rotation @ self.centre_mm
        return self.lens.matrix_px @ jnp.concatenate([self.rotation, translation[:, None]], axis=1)

    @property
    def aim_mm(self) -> Float[ArrayLike, "2"]:
        """The point of Z = 0 on the optical axis."""
        return (self.centre_mm + self.distance_mm * self.rotation[2])[:2]

    @property
    def distance_mm(self) -> Float[ArrayLike, ""]:
        """From the aim to the centre."""
        return -self.centre_mm[2] / self.rotation[2, 2]

    def undistorted(self, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """The pixel at which a lens without distortion would image the same ray."""
        if self.lens.distortion is None:
            return uv_px
        return self.lens.affine(self.lens.normalised_from_pixel(uv_px))

    def moved(self, step: Float[ArrayLike, "p"]) -> "CameraState":
        """This camera after a small step; zero leaves it as it is.

        All entries are of one scale: radians, shares of `reach_mm`, shares of the focal
        length, and thousands of pixels of the principal point.
        """
        rotation = rotation_from_vector(step[:3]) @ self.rotation
        if self.freedom is Freedom.POSE:
            centre, used = self.centre_mm + self.reach_mm * step[3:6], 6
        else:
            aim, used = self.aim_mm, len(self.freedom.value)
            if self.freedom is Freedom.SIX:
                aim = aim + self.reach_mm * step[4:6]
            distance = self.distance_mm + self.reach_mm * step[3]
            centre = jnp.append(aim, 0.0) - distance * rotation[2]
        lens = self.lens
        if self.with_intrinsics:
            focal = 1 + step[used : used + 2]
            shift = PRINCIPAL_POINT_STEP_PX * step[used + 2 : used + 4]
            (fu, skew, cu), (_, fv, cv), last = lens.matrix_px
            zero = jnp.zeros_like(fu)
            first = jnp.stack([focal[0] * fu, focal[0] * skew, cu + shift[0]])
            second = jnp.stack([zero, focal[1] * fv, cv + shift[1]])
            lens = LensArrays(jnp.stack([first, second, jnp.asarray(last)]), lens.distortion)
        return CameraState(
            rotation, centre, lens, self.reach_mm, self.freedom, self.with_intrinsics
        )

    def parameters(self, start: "CameraState") -> Float[ArrayLike, "p"]:
        """Values of the named parameters, in degrees, millimetres and pixels.

        Small motions (Freedom.POSE) are those from `start`.
        """
        if self.freedom is Freedom.POSE:
            turn = _rotation_vector(self.rotation @ start.rotation.T)
            values = [jnp.degrees(turn), self.centre_mm - start.centre_mm]
        else:
            angles = jnp.stack(pan_tilt_swing_from_rotation(self.rotation))
            values = [jnp.degrees(angles), self.distance_mm[None], self.aim_mm]
            values = [jnp.concatenate(values)[: len(self.freedom.value)]]
        if self.with_intrinsics:
            matrix = self.lens.matrix_px
            values.append(jnp.stack([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]))
        return jnp.concatenate(values)

    def parameters_by_step(self, start: "CameraState") -> Float[ArrayLike, "p p"]:
        """Jacobian of `parameters` with respect to a step from here."""
        zero = jnp.zeros(len(self.names))
        return jax.jacfwd(lambda step: self.moved(step).parameters(start))(zero)


def camera_state(
    camera: Camera, freedom: Freedom, *, with_intrinsics: bool, with_distortion: bool
) -> CameraState:
    """The state of a camera before refinement."""
    centre = jnp.asarray(camera.centre_world_mm)
    reach = camera.distance_mm if freedom is not Freedom.POSE else jnp.sqrt(centre @ centre)
    return CameraState(
        jnp.asarray(camera.pose.rotation),
        centre,
        lens_arrays(camera.intrinsics, with_distortion),
        jnp.asarray(reach),
        freedom,
        with_intrinsics,
    )


def camera_of_state(state: CameraState, start: Camera) -> Camera:
    """The camera of a refined state; what refinement does not touch comes from `start`."""
    translation = -state.rotation @ state.centre_mm
    pose = Pose(jnp.concatenate([state.rotation, translation[:, None]], axis=1))
    if not state.with_intrinsics:
        return Camera(start.intrinsics, pose)
    matrix = state.lens.matrix_px
    intrinsics = eqx.tree_at(
        lambda lens: (lens.focal_length_px, lens.principal_point_px),
        start.intrinsics,
        (jnp.stack([matrix[0, 0], matrix[1, 1]]), matrix[:2, 2]),
    )
    return Camera(intrinsics, pose)


def _rotation_vector(rotation: Float[ArrayLike, "3 3"]) -> Float[ArrayLike, "3"]:
    """Logarithm of a rotation by less than a quarter turn."""
    axis = 0.5 * jnp.stack(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    squared = axis @ axis
    small = squared < 1e-12
    sine = jnp.sqrt(jnp.where(small, 1.0, squared))
    return axis * jnp.where(small, 1 + squared / 6, jnp.arcsin(sine) / sine)
