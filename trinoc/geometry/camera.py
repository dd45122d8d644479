"""One camera: intrinsics and a pose; its projection, and the way back."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.linalg import rq

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import mask_folded, project_point
from trinoc.numerics.precision import (
    ArrayLike,
    FloatOrTraced,
    NumpyOrTraced,
    ScalarLike,
    array_namespace,
    as_float,
    in_float64,
    is_traced,
    real_array,
)
from trinoc.numerics.values import Value

# Of the method's four parameters.
POSE_NAMES = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")


class Camera(Value):
    """A calibrated camera. Its pan, tilt, swing, distance and aim are derived from the pose.

    Constructors and properties give NumPy numbers in double precision; what `jit`, `grad` or
    `vmap` traces they trace.
    """

    intrinsics: Intrinsics
    pose: Pose

    def __repr__(self) -> str:
        if is_traced(self):
            return super().__repr__()
        numbers = [f"{name}={getattr(self, name):.6g}" for name in POSE_NAMES]
        if not np.isfinite(self.distance_mm):
            x, y, z = (f"{each:.6g}" for each in self.centre_world_mm)
            numbers[-1] = f"centre_world_mm=({x}, {y}, {z})"
        return f"<Camera: {', '.join(numbers)}, {self.intrinsics!r}>"

    @classmethod
    @in_float64
    def from_degrees(
        cls,
        intrinsics: Intrinsics,
        *,
        pan_deg: ScalarLike,
        tilt_deg: ScalarLike,
        swing_deg: ScalarLike,
        distance_mm: ScalarLike,
        aim_mm: Sequence[ScalarLike] | Float[ArrayLike, "2"] = (0.0, 0.0),
    ) -> "Camera":
        """A camera from the method's parameters as people write them."""
        angles = (pan_deg, tilt_deg, swing_deg, distance_mm)
        if not is_traced(angles, aim_mm):
            aim_mm = real_array(aim_mm, "aim_mm")
            numbers = real_array(angles, "The pose")
            if numbers.shape != (4,) or aim_mm.shape != (2,):
                raise InputError(
                    "A pose is one number each for pan, tilt, swing and distance, and two for "
                    f"aim_mm, but these have the shapes {numbers.shape[1:]} and {aim_mm.shape}."
                )
        given = (*angles, *aim_mm)
        xp = array_namespace(given)
        values = xp.stack([xp.asarray(value, float) for value in given])
        parameters = xp.concatenate([xp.radians(values[:3]), values[3:]])
        return cls(intrinsics, Pose.from_parameters(parameters))

    @classmethod
    def from_matrix(cls, projection_px: ArrayLike, image_size_px: tuple[int, int]) -> "Camera":
        """A camera from any (3, 4) projection matrix, of any scale and sign.

        The unit and origin of the world are the matrix's own. Raises InputError for another
        shape, entries that are not finite, or a camera without a finite centre. Source:
        Hartley and Zisserman, section 6.2.4.
        """
        matrix = real_array(projection_px, "The projection matrix")
        if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
            raise InputError(
                f"A projection matrix must be 3x4 with finite entries, but this one has shape "
                f"{matrix.shape} and {np.count_nonzero(~np.isfinite(matrix))} others."
            )
        determinant = np.linalg.det(matrix[:, :3])
        if not abs(determinant) > 1e-12 * np.linalg.norm(matrix[:, :3]) ** 3:
            raise InputError(
                "The projection matrix has no finite centre (its left 3x3 part is singular): "
                "give the matrix of a perspective camera."
            )
        # With a positive determinant, K with a positive diagonal leaves a proper rotation.
        matrix = np.sign(determinant) * matrix
        calibration, rotation = _rq_decomposition(matrix[:, :3])
        translation = np.linalg.solve(calibration, matrix[:, 3])
        return cls(
            Intrinsics.from_matrix(calibration, image_size_px),
            Pose(np.concatenate([rotation, translation[:, None]], axis=1)),
        )

    @property
    def cam_from_world(self) -> Float[ArrayLike, "3 4"]:
        """[R | t], world (mm) to camera frame (x right, y down, z forward)."""
        return self.pose.cam_from_world

    @property
    def image_size_px(self) -> tuple[int, int]:
        """(width, height) of the pictures."""
        return self.intrinsics.image_size_px

    @property
    def matrix_px(self) -> Float[NumpyOrTraced, "3 4"]:
        """(3, 4) projection matrix K [R | t]; lens distortion, if any, comes after it."""
        return _projection(self)

    @property
    def centre_world_mm(self) -> Float[NumpyOrTraced, "3"]:
        """(3,) centre of projection in the world frame."""
        return _centre_world_mm(self.pose)

    @property
    def pan_deg(self) -> FloatOrTraced:
        """Azimuth from -Y toward +X."""
        return as_float(_parameters_deg(self.pose)[0])

    @property
    def tilt_deg(self) -> FloatOrTraced:
        """Elevation above Z = 0."""
        return as_float(_parameters_deg(self.pose)[1])

    @property
    def swing_deg(self) -> FloatOrTraced:
        """Turn of the picture's x toward its y."""
        return as_float(_parameters_deg(self.pose)[2])

    @property
    def distance_mm(self) -> FloatOrTraced:
        """From the aim to the centre; NaN where the axis does not meet Z = 0 in front."""
        return as_float(_parameters_deg(self.pose)[3])

    @property
    def aim_mm(self) -> tuple[FloatOrTraced, FloatOrTraced]:
        """The point (X, Y) of Z = 0 on the optical axis; NaN where there is none."""
        x, y = _parameters_deg(self.pose)[4:6]
        return as_float(x), as_float(y)

    def project(self, point_world_mm: Float[ArrayLike, "3"]) -> Float[NumpyOrTraced, "2"]:
        """The pixel that images a point, lens distortion included (see `project`).

        NaN beyond the fold of the lens (`Intrinsics.valid_radius_px`).
        """
        if not is_traced(point_world_mm):
            point_world_mm = real_array(point_world_mm, "The point")
            if point_world_mm.shape != (3,):
                raise InputError(
                    f"The point has shape {point_world_mm.shape}, but must be (3,): X, Y and Z in "
                    "mm; `jax.vmap` of `trinoc.geometry.project` takes many."
                )
        uv_px = _project(self, point_world_mm)
        return mask_folded(self.pose, self.intrinsics.lens, point_world_mm, uv_px)


def projection_matrix(camera: Camera) -> Float[ArrayLike, "3 4"]:
    """K [R | t] without the precision and the NumPy of `Camera.matrix_px`, for inner functions."""
    return camera.intrinsics.lens.matrix @ camera.cam_from_world


def project(camera: Camera, point_world_mm: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
    """The pixel that images a point, lens distortion included.

    Meaningless for a point behind the camera, whose depth (`depth_mm`) is not positive. NaN beyond
    the fold of the lens (`Intrinsics.valid_radius_px`), unless the camera is traced.
    """
    uv_px = project_point(camera.pose, camera.intrinsics.lens, point_world_mm)
    return mask_folded(camera.pose, camera.intrinsics.lens, point_world_mm, uv_px)


def depth_mm(camera: Camera, point_world_mm: Float[ArrayLike, "3"]) -> Float[ArrayLike, ""]:
    """z of a point in the camera frame: positive in front of the camera."""
    return camera.cam_from_world[2, :3] @ point_world_mm + camera.cam_from_world[2, 3]


def viewing_direction(camera: Camera, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
    """Unit vector, in the world frame, from the centre along the ray of a pixel."""
    return camera.pose.rotation.T @ camera.intrinsics.lens.unproject(uv_px)


def sheet_from_pixel(camera: Camera, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
    """(X, Y) in mm where the ray of a pixel meets the sheet Z = 0; NaN as in `project`."""
    centre, direction = camera.pose.centre_world_mm, viewing_direction(camera, uv_px)
    place_mm = (centre - centre[2] / direction[2] * direction)[:2]
    return camera.intrinsics.lens.mask_pixel(uv_px, place_mm)


# Operation by operation they take a millisecond, which a batch of frames feels.
_project = in_float64(jax.jit(project))


_projection: Callable[[Camera], Any] = in_float64(projection_matrix)
_centre_world_mm = in_float64(lambda pose: pose.centre_world_mm)


@in_float64
def _parameters_deg(pose: Pose) -> Float[ArrayLike, "6"]:
    xp, parameters = array_namespace(pose), pose.parameters
    return xp.concatenate([xp.degrees(parameters[:3]), parameters[3:]])


def _rq_decomposition(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(upper triangular with positive diagonal, orthogonal) factors of a 3x3 matrix."""
    upper, rotation = rq(matrix)
    signs = np.diag(np.sign(np.diag(upper)))
    return upper @ signs, signs @ rotation
