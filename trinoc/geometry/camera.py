"""One camera: intrinsics and a pose. Projection of points, and the sheet point of a pixel."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
import scipy
from jaxtyping import Float

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

# The four pose parameters of the method.
POSE_NAMES = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")


class Camera(Value):
    """A calibrated camera: a lens with image size, and a pose.

    Pan, tilt, swing, distance and aim are computed from the pose. Values are NumPy, float64. Inside
    JAX's `jit`, `grad` and `vmap` they are traced values, which have no numbers yet.

    Attributes
    ----------
    intrinsics : Intrinsics
        Lens and image size.
    pose : Pose
        Position and orientation, cam_from_world.
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
        """Create a camera from pan, tilt, swing, distance and aim.

        Parameters
        ----------
        intrinsics : Intrinsics
            Lens and image size.
        pan_deg : float
            Azimuth of the camera seen from the aim, degrees: 0 on the -Y side, 90 on the +X side.
        tilt_deg : float
            Elevation of the camera above the sheet Z = 0, seen from the aim, degrees.
        swing_deg : float
            Rotation of the camera about its optical axis, degrees, from its x axis toward its y
            axis.
        distance_mm : float
            Distance from the aim to the centre of projection.
        aim_mm : (2,)
            Intersection (X, Y) of the optical axis with the sheet.

        Returns
        -------
        Camera

        Raises
        ------
        InputError
            If a parameter is not one number, or `aim_mm` is not two numbers.
        """
        angles = (pan_deg, tilt_deg, swing_deg, distance_mm)
        if not is_traced(angles, aim_mm):
            aim_mm = real_array(aim_mm, "aim_mm")
            numbers = real_array(angles, "The pose")
            if numbers.shape != (4,) or aim_mm.shape != (2,):
                raise InputError(
                    "Pan, tilt, swing and distance must be one number each and aim_mm two numbers, "
                    f"but their shapes are {numbers.shape[1:]} and {aim_mm.shape}."
                )
        scalars = (*angles, *aim_mm)
        xp = array_namespace(scalars)
        values = xp.stack([xp.asarray(value, float) for value in scalars])
        parameters = xp.concatenate([xp.radians(values[:3]), values[3:]])
        return cls(intrinsics, Pose.from_parameters(parameters))

    @classmethod
    def from_matrix(cls, projection_px: ArrayLike, image_size_px: tuple[int, int]) -> "Camera":
        """Create a camera from any (3, 4) projection matrix, of any scale and sign.

        Parameters
        ----------
        projection_px : (3, 4)
            Projection matrix, from world coordinates to pixels. Its unit and origin of the world
            become those of the camera.
        image_size_px : (width, height)
            Size of the images.

        Returns
        -------
        Camera
            A camera without distortion.

        Raises
        ------
        InputError
            If the shape is different, entries are not finite, or the camera has no finite centre.

        References
        ----------
        Hartley and Zisserman, "Multiple View Geometry" (2003), section 6.2.4.
        """
        matrix = real_array(projection_px, "The projection matrix")
        if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
            raise InputError(
                f"A projection matrix must be 3x4 with finite entries, but this one has shape "
                f"{matrix.shape} and {np.count_nonzero(~np.isfinite(matrix))} entries that are not "
                "finite."
            )
        determinant = np.linalg.det(matrix[:, :3])
        if not abs(determinant) > 1e-12 * np.linalg.norm(matrix[:, :3]) ** 3:
            raise InputError(
                "The projection matrix has no finite centre, because its left 3x3 part is "
                "singular. Give the matrix of a perspective camera."
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
        """Pose [R | t] (3, 4) with x_cam = R X + t, mm. Camera axes: x right, y down, z forward."""
        return self.pose.cam_from_world

    @property
    def image_size_px(self) -> tuple[int, int]:
        """Size (width, height) of the images."""
        return self.intrinsics.image_size_px

    @property
    def matrix_px(self) -> Float[NumpyOrTraced, "3 4"]:
        """Projection matrix K [R | t] (3, 4) from the world to pixels, without lens distortion."""
        return _projection(self)

    @property
    def centre_world_mm(self) -> Float[NumpyOrTraced, "3"]:
        """Centre of projection in the world frame, (3,) mm."""
        return _centre_world_mm(self.pose)

    @property
    def pan_deg(self) -> FloatOrTraced:
        """Azimuth of the camera seen from the aim, degrees: 0 on the -Y side, 90 on the +X side."""
        return as_float(_parameters_deg(self.pose)[0])

    @property
    def tilt_deg(self) -> FloatOrTraced:
        """Elevation of the camera above the sheet Z = 0, seen from the aim, degrees."""
        return as_float(_parameters_deg(self.pose)[1])

    @property
    def swing_deg(self) -> FloatOrTraced:
        """Rotation about the optical axis, degrees, of the camera's x axis toward its y axis."""
        return as_float(_parameters_deg(self.pose)[2])

    @property
    def distance_mm(self) -> FloatOrTraced:
        """Distance from the aim to the centre of projection, mm; NaN if there is no aim."""
        return as_float(_parameters_deg(self.pose)[3])

    @property
    def aim_mm(self) -> tuple[FloatOrTraced, FloatOrTraced]:
        """Intersection (X, Y) of the optical axis with the sheet Z = 0, mm.

        NaN if the axis does not meet the sheet in front of the camera.
        """
        x, y = _parameters_deg(self.pose)[4:6]
        return as_float(x), as_float(y)

    def project(self, point_world_mm: Float[ArrayLike, "3"]) -> Float[NumpyOrTraced, "2"]:
        """Return the pixel that images a point, lens distortion included.

        Parameters
        ----------
        point_world_mm : (3,)
            Point in the world frame.

        Returns
        -------
        (2,)
            Pixel (u, v). NaN beyond the fold of the lens (`Intrinsics.valid_radius_px`).
            Meaningless for a point behind the camera.

        Raises
        ------
        InputError
            If the point does not have shape (3,).
        """
        if not is_traced(point_world_mm):
            point_world_mm = real_array(point_world_mm, "The point")
            if point_world_mm.shape != (3,):
                raise InputError(
                    f"The point has shape {point_world_mm.shape}, but must be (3,): X, Y and Z in "
                    "mm. For many points use `jax.vmap` of `trinoc.geometry.project`."
                )
        uv_px = _project(self, point_world_mm)
        return mask_folded(self.pose, self.intrinsics.lens, point_world_mm, uv_px)


def projection_matrix(camera: Camera) -> Float[ArrayLike, "3 4"]:
    """Projection matrix K [R | t] (3, 4), in the camera's own precision, float32 or float64.

    For use under `jit`. `Camera.matrix_px` is the same matrix in float64.
    """
    return camera.intrinsics.lens.matrix @ camera.cam_from_world


def project(camera: Camera, point_world_mm: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
    """Return the pixel that images a point, lens distortion included.

    Parameters
    ----------
    camera : Camera
        Camera; may be a traced value of `jit` or `grad`.
    point_world_mm : (3,)
        Point in the world frame.

    Returns
    -------
    (2,)
        Pixel (u, v). NaN beyond the fold of the lens (`Intrinsics.valid_radius_px`), unless the
        camera is traced. Meaningless for a point behind the camera (`depth_mm` not positive).
    """
    uv_px = project_point(camera.pose, camera.intrinsics.lens, point_world_mm)
    return mask_folded(camera.pose, camera.intrinsics.lens, point_world_mm, uv_px)


def depth_mm(camera: Camera, point_world_mm: Float[ArrayLike, "3"]) -> Float[ArrayLike, ""]:
    """Depth of a world point: z in the camera frame, mm, positive in front of the camera."""
    return camera.cam_from_world[2, :3] @ point_world_mm + camera.cam_from_world[2, 3]


def viewing_direction(camera: Camera, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
    """Unit vector (3,), in the world frame, along the viewing ray of a pixel."""
    return camera.pose.rotation.T @ camera.intrinsics.lens.unproject(uv_px)


def sheet_from_pixel(camera: Camera, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
    """Return the intersection of the ray of a pixel with the sheet Z = 0.

    Parameters
    ----------
    camera : Camera
        Camera; may be a traced value of `jit` or `grad`.
    uv_px : (2,)
        Pixel (u, v), lens distortion included.

    Returns
    -------
    (2,)
        (X, Y) in mm. NaN beyond the fold of the lens, unless the camera is traced.
    """
    centre, direction = camera.pose.centre_world_mm, viewing_direction(camera, uv_px)
    point_mm = (centre - centre[2] / direction[2] * direction)[:2]
    return camera.intrinsics.lens.mask_pixel(uv_px, point_mm)


# Compiled: operation by operation a call takes a millisecond, which adds up in a batch of frames.
_project = in_float64(jax.jit(project))
_projection: Callable[[Camera], Any] = in_float64(projection_matrix)
_centre_world_mm = in_float64(lambda pose: pose.centre_world_mm)


@in_float64
def _parameters_deg(pose: Pose) -> Float[ArrayLike, "6"]:
    xp, parameters = array_namespace(pose), pose.parameters
    return xp.concatenate([xp.degrees(parameters[:3]), parameters[3:]])


def _rq_decomposition(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """RQ decomposition of a (3, 3) matrix: (upper triangular K, orthogonal R).

    The diagonal of K is positive.
    """
    upper, rotation = scipy.linalg.rq(matrix)
    signs = np.diag(np.sign(np.diag(upper)))
    return upper @ signs, signs @ rotation
