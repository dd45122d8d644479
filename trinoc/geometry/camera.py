"""One camera: intrinsics and a pose; its projection, and the way back."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics, calibration_matrix
from trinoc.geometry.pose import PanTiltPose, Pose
from trinoc.numerics import ArrayLike, in_float64


class Camera(eqx.Module):
    """A calibrated camera. Its pan, tilt, swing, distance and aim are derived from the pose."""

    intrinsics: Intrinsics
    pose: Pose

    @classmethod
    def from_pan_tilt(cls, intrinsics: Intrinsics, parameters: PanTiltPose) -> "Camera":
        """A camera from the method's parameters, in radians and millimetres."""
        return cls(intrinsics, parameters.pose)

    @classmethod
    @in_float64
    def from_degrees(
        cls,
        intrinsics: Intrinsics,
        *,
        pan_deg: float,
        tilt_deg: float,
        swing_deg: float,
        distance_mm: float,
        aim_mm: tuple[float, float] = (0.0, 0.0),
    ) -> "Camera":
        """A camera from the method's parameters as people write them."""
        pan, tilt, swing = np.radians(np.array([pan_deg, tilt_deg, swing_deg], dtype=np.float64))
        vector = np.array([pan, tilt, swing, distance_mm, *aim_mm], dtype=np.float64)
        return cls(intrinsics, PanTiltPose.from_vector(vector).pose)

    @classmethod
    def from_matrix(cls, projection_px: ArrayLike, image_size_px: tuple[int, int]) -> "Camera":
        """A camera from any (3, 4) projection matrix, of any scale and sign.

        The unit and origin of the world are the matrix's own. Raises InputError for another
        shape, entries that are not finite, or a camera without a finite centre. Source:
        Hartley and Zisserman, section 6.2.4.
        """
        matrix = np.asarray(projection_px, dtype=np.float64)
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
    @in_float64
    def matrix_px(self) -> np.ndarray:
        """(3, 4) projection matrix K [R | t]; lens distortion, if any, comes after it."""
        k = self.intrinsics
        matrix = _projection(
            k.focal_length_px, k.principal_point_px, k.skew_px, self.cam_from_world
        )
        return np.asarray(matrix)

    @property
    @in_float64
    def centre_world_mm(self) -> np.ndarray:
        """(3,) centre of projection in the world frame."""
        return np.asarray(self.pose.centre_world_mm)

    @property
    def pan_deg(self) -> float:
        """Azimuth from -Y toward +X."""
        return float(np.degrees(self._pan_tilt.pan_rad))

    @property
    def tilt_deg(self) -> float:
        """Elevation above Z = 0."""
        return float(np.degrees(self._pan_tilt.tilt_rad))

    @property
    def swing_deg(self) -> float:
        """Turn of the picture's x toward its y."""
        return float(np.degrees(self._pan_tilt.swing_rad))

    @property
    def distance_mm(self) -> float:
        """From the aim to the centre; NaN where the axis does not meet Z = 0 in front."""
        return float(self._pan_tilt.distance_mm)

    @property
    def aim_mm(self) -> tuple[float, float]:
        """The point (X, Y) of Z = 0 on the optical axis; NaN where there is none."""
        x, y = np.asarray(self._pan_tilt.aim_mm)
        return float(x), float(y)

    @property
    @in_float64
    def _pan_tilt(self) -> PanTiltPose:
        return PanTiltPose.from_pose(self.pose)


def projection_matrix(camera: Camera) -> Float[ArrayLike, "3 4"]:
    """K [R | t] for use under `jit` and `grad`; `Camera.matrix_px` is the same as NumPy."""
    return camera.intrinsics.matrix @ camera.cam_from_world


def project(camera: Camera, point_world_mm: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
    """The pixel that images a point, lens distortion included.

    Meaningless for a point behind the camera, whose depth (`depth_mm`) is not positive.
    """
    point_cam = camera.pose.rotation @ point_world_mm + camera.cam_from_world[:, 3]
    return camera.intrinsics.pixel_from_normalised(point_cam[:2] / point_cam[2])


def depth_mm(camera: Camera, point_world_mm: Float[ArrayLike, "3"]) -> Float[ArrayLike, ""]:
    """z of a point in the camera frame: positive in front of the camera."""
    return camera.cam_from_world[2, :3] @ point_world_mm + camera.cam_from_world[2, 3]


def viewing_direction(camera: Camera, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
    """Unit vector, in the world frame, from the centre along the ray of a pixel."""
    normalised = camera.intrinsics.normalised_from_pixel(uv_px)
    direction = camera.pose.rotation.T @ jnp.append(normalised, 1.0)
    return direction / jnp.sqrt(direction @ direction)


def sheet_from_pixel(camera: Camera, uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
    """(X, Y) in mm where the ray of a pixel meets the sheet Z = 0."""
    centre, direction = camera.pose.centre_world_mm, viewing_direction(camera, uv_px)
    return (centre - centre[2] / direction[2] * direction)[:2]


def pixel_from_sheet_homography(camera: Camera) -> Float[ArrayLike, "3 3"]:
    """Homography of the sheet Z = 0 to undistorted pixels: columns 1, 2 and 4 of K [R | t]."""
    return projection_matrix(camera)[:, jnp.array([0, 1, 3])]


@jax.jit
def _projection(
    focal_length_px: Float[ArrayLike, "2"],
    principal_point_px: Float[ArrayLike, "2"],
    skew_px: Float[ArrayLike, ""],
    cam_from_world: Float[ArrayLike, "3 4"],
) -> Float[ArrayLike, "3 4"]:
    # Operation by operation it takes a millisecond, which a batch of frames feels.
    return calibration_matrix(focal_length_px, principal_point_px, skew_px) @ cam_from_world


def _rq_decomposition(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(upper triangular with positive diagonal, orthogonal) factors of a 3x3 matrix."""
    reverse = np.eye(3)[::-1]
    orthogonal, triangular = np.linalg.qr((reverse @ matrix).T)
    upper, rotation = reverse @ triangular.T @ reverse, reverse @ orthogonal.T
    signs = np.diag(np.sign(np.diag(upper)))
    return upper @ signs, signs @ rotation
