"""State of a camera during refinement: pose, lens, and their local coordinates."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.geometry.camera import Camera
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.registry import stack_lenses
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.numerics.precision import ArrayLike, array_namespace

# numerical: a unit step doubles the focal length and moves the principal point by 1000 px.
PRINCIPAL_POINT_STEP_PX = 1000.0


class CameraState(eqx.Module):
    """One camera during a refinement: pose, lens, and the parameters that are refined.

    The states of several cameras can be stacked along a first axis, for `vmap`.

    Attributes
    ----------
    pose : pose of the camera.
    lens : lens of the camera. Stacked cameras have lenses of one model (`stack_states`).
    working_distance_mm : length that corresponds to a unit change of a translation; about the
        distance of the scene.
    pose_model : refined parameters of the pose.
    with_intrinsics : whether focal lengths and principal point are refined, too.
    """

    pose: Pose
    lens: AbstractLens
    working_distance_mm: Float[ArrayLike, ""]
    pose_model: PoseModel = eqx.field(static=True)
    with_intrinsics: bool = eqx.field(static=True)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the refined parameters, in the order of `parameters`."""
        return self.pose_model.parameter_names + (AFFINE_PARAMETERS if self.with_intrinsics else ())

    @property
    def matrix_px(self) -> Float[ArrayLike, "3 4"]:
        """Projection matrix K [R | t], (3, 4), which maps world points to undistorted pixels."""
        return self.lens.matrix @ self.pose.cam_from_world

    def retract(self, delta: Float[ArrayLike, "p"]) -> "CameraState":
        """Camera after a small change of its p local coordinates.

        All local coordinates have similar scales: rad, translation / `working_distance_mm`,
        relative change of the focal lengths, and 1000 px for the principal point.
        """
        count = self.pose_model.size
        pose = self.pose.retract(delta[:count], self.pose_model, self.working_distance_mm)
        lens = self.lens
        if self.with_intrinsics:
            scaled = lens.with_focal_factor(1 + delta[count : count + 2])
            shift = PRINCIPAL_POINT_STEP_PX * delta[count + 2 : count + 4]
            lens = scaled.retract(jnp.concatenate([jnp.zeros_like(shift), shift]))
        return CameraState(
            pose, lens, self.working_distance_mm, self.pose_model, self.with_intrinsics
        )

    def parameters(self, origin: "CameraState") -> Float[ArrayLike, "p"]:
        """Values of the refined parameters, (p,), in degrees, mm and px.

        Rigid motions are relative to the pose of `origin`.
        """
        values = self.pose.model_parameters(self.pose_model, origin.pose)
        values = jnp.concatenate([jnp.degrees(values[:3]), values[3:]])
        if self.with_intrinsics:
            values = jnp.concatenate([values, self.lens.parameters[: len(AFFINE_PARAMETERS)]])
        return values

    def d_parameters_d_delta(self, origin: "CameraState") -> Float[ArrayLike, "p p"]:
        """Jacobian, (p, p), of `parameters` with respect to the local coordinates of `retract`."""
        zero = jnp.zeros(len(self.names))
        return jax.jacfwd(lambda delta: self.retract(delta).parameters(origin))(zero)


def camera_state(
    camera: Camera, pose_model: PoseModel, *, with_intrinsics: bool = False
) -> CameraState:
    """State of a calibrated camera before its refinement.

    pose_model : parameters of the pose that will be refined.
    with_intrinsics : whether focal lengths and principal point will be refined, too.
    """
    centre = camera.centre_world_mm
    xp = array_namespace(centre)
    rigid = pose_model is PoseModel.RIGID
    working_distance = xp.sqrt(centre @ centre) if rigid else camera.distance_mm
    lens = camera.intrinsics.lens
    return CameraState(camera.pose, lens, xp.asarray(working_distance), pose_model, with_intrinsics)


def stack_states(states: Sequence[CameraState]) -> CameraState:
    """Stack several cameras along a new first axis.

    Raises `InputError` if their lenses are not of one model.
    """
    lens = stack_lenses([state.lens for state in states])
    with_first_lens = [
        eqx.tree_at(lambda state: state.lens, state, states[0].lens) for state in states
    ]
    xp = array_namespace(with_first_lens, lens)
    stacked = jax.tree.map(lambda *leaves: xp.stack(leaves).astype(float), *with_first_lens)
    lens = jax.tree.map(lambda leaf: xp.asarray(leaf, float), lens)
    return eqx.tree_at(lambda state: state.lens, stacked, lens)


def camera_of_state(state: CameraState, start: Camera) -> Camera:
    """Convert a refined state to a camera. Properties that are not refined are those of `start`."""
    if not state.with_intrinsics:
        return Camera(start.intrinsics, state.pose)
    start_lens, refined = start.intrinsics.lens, state.lens
    lens = type(start_lens)(
        refined.focal_length_px,
        refined.principal_point_px,
        refined.skew_px,
        start_lens.coefficients,
    )
    return Camera(
        eqx.tree_at(lambda intrinsics: intrinsics.lens, start.intrinsics, lens), state.pose
    )
