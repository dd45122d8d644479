"""Rigid motions in other tools' notations: checks, composition, quaternions, rotation vectors."""

import numpy as np
import scipy
from jaxtyping import Float

from trinoc.errors import InputError

# Rotations to this many digits are taken as they are; those that a few digits are missing of, as
# files of single precision have them, are brought to the nearest rotation.
EXACT, ROUNDED = 1e-12, 1e-4
# Of a translation in mm; cameras are nearer than this, in any unit.
FARTHEST_MM = 1e15


def motion(
    rotation: Float[np.ndarray, "3 3"], translation_mm: Float[np.ndarray, "3"], where: str
) -> Float[np.ndarray, "3 4"]:
    """Rigid motion [R | t] (3, 4) from a rotation and a translation in mm.

    Raise `InputError` if the matrix is not a rotation. `where` begins the message: file and key.
    """
    if not np.abs(translation_mm).max() < FARTHEST_MM:
        raise InputError(f"{where} has a translation that is too large: correct it.")
    return np.concatenate([checked_rotation(rotation, where), translation_mm[:, None]], axis=1)


def checked_rotation(rotation: Float[np.ndarray, "3 3"], where: str) -> Float[np.ndarray, "3 3"]:
    """Return the rotation nearest to `rotation`, which may have rounding errors up to 1e-4.

    Raise `InputError` if the matrix is not a rotation. `where` begins the message: file and key.
    """
    small = np.abs(rotation).max() < 2  # products of larger ones may overflow
    error = np.abs(rotation @ rotation.T - np.eye(3)).max() if small else np.inf
    if not error < ROUNDED:
        raise InputError(f"{where} is no rotation matrix (R R^T differs from 1): correct it.")
    if np.linalg.det(rotation) < 0:
        raise InputError(f"{where} is a reflection, not a rotation: check the order of the axes.")
    if error < EXACT:
        return rotation
    left, _, right = np.linalg.svd(rotation)
    return left @ right


def from_homogeneous(
    matrix: Float[np.ndarray, "4 4"], unit_mm: float, where: str
) -> Float[np.ndarray, "3 4"]:
    """Rigid motion [R | t] (3, 4) in mm from a homogeneous matrix in units of `unit_mm`.

    Raise `InputError` if the matrix is not a rigid motion. `where` begins the message: file and
    key.
    """
    if not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=1e-12):
        raise InputError(f"{where} is no rigid motion: its last row must be 0 0 0 1.")
    return motion(matrix[:3, :3], matrix[:3, 3] * unit_mm, where)


def homogeneous(pose: Float[np.ndarray, "3 4"], unit_mm: float = 1.0) -> Float[np.ndarray, "4 4"]:
    """Homogeneous matrix (4, 4) in units of `unit_mm` from a rigid motion [R | t] in mm."""
    matrix = np.eye(4)
    matrix[:3] = pose
    matrix[:3, 3] /= unit_mm
    return matrix


def chain_motions(
    second: Float[np.ndarray, "3 4"], first: Float[np.ndarray, "3 4"]
) -> Float[np.ndarray, "3 4"]:
    """Composition of two rigid motions [R | t]; `first` is applied first, (3, 4)."""
    return second @ homogeneous(first)


def inverse(pose: Float[np.ndarray, "3 4"]) -> Float[np.ndarray, "3 4"]:
    """Inverse of a rigid motion [R | t], (3, 4)."""
    rotation = pose[:, :3].T
    return np.concatenate([rotation, -(rotation @ pose[:, 3])[:, None]], axis=1)


def quaternion_wxyz(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """Unit quaternion (w, x, y, z) of a rotation, with w >= 0."""
    x, y, z, w = scipy.spatial.transform.Rotation.from_matrix(rotation).as_quat(canonical=True)
    return np.array([w, x, y, z])


def rotation_of_quaternion(wxyz: Float[np.ndarray, "4"], where: str) -> Float[np.ndarray, "3 3"]:
    """Rotation (3, 3) of a unit quaternion (w, x, y, z).

    Raise `InputError` if the length differs from 1 by more than 1e-4, which is the rounding of
    files. `where` begins the message: file and key.
    """
    if not (np.abs(wxyz).max() < 2 and abs(np.linalg.norm(wxyz) - 1) < ROUNDED):
        raise InputError(f"{where} is no unit quaternion: correct it.")
    w, x, y, z = wxyz
    return scipy.spatial.transform.Rotation.from_quat([x, y, z, w]).as_matrix()


def rotation_vector(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Rotation vector (3,) of a rotation: unit axis times angle in rad."""
    return scipy.spatial.transform.Rotation.from_matrix(rotation).as_rotvec()


def rotation_of_vector(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation (3, 3) of a rotation vector; inverse of `rotation_vector`."""
    return scipy.spatial.transform.Rotation.from_rotvec(vector).as_matrix()
