"""Several cameras in one world frame, with the covariance of their parameters."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError, check_kind, list_names
from trinoc.geometry.camera import POSE_NAMES, Camera
from trinoc.numerics.display import Displayable
from trinoc.numerics.precision import ArrayLike, is_traced, real_array
from trinoc.numerics.values import Value

# Centres are equal if their separation is below this share of their distance from the origin.
_EQUAL_CENTRES = 1e-6
# Names of the current and the parent folder.
_NO_NAMES = (".", "..")
# Remedy for an argument that must be a rig.
A_RIG = "a trinoc.Rig, such as load_rig reads from a file"
PARAMETER_NAMES = (*POSE_NAMES, "aim_x_mm", "aim_y_mm")


def is_camera_name(name: object) -> bool:
    """True if a name is usable in files, tables and messages.

    The characters must be printable and not all blank; "." and ".." are excluded.
    """
    text = isinstance(name, str)
    return text and name.isprintable() and bool(name.strip()) and name not in _NO_NAMES


def check_camera_names(names: Iterable[object]) -> None:
    """Raise `InputError` for the first camera name that `is_camera_name` rejects."""
    for name in names:
        if not is_camera_name(name):
            raise InputError(
                f"The camera name {name!r} is not allowed. Use printable characters; blank, . and "
                ".. alone are reserved."
            )


class Rig(Displayable, Value):
    """Named cameras in one world frame, in the order the user gave them.

    Attributes
    ----------
    names : tuple of str
        Name of each camera.
    cameras : tuple of Camera
        Cameras, in the order of `names`.
    parameters : tuple of str
        Names ("upper.pan_deg", ...) of the rows of `covariance`; empty if the covariance is
        unknown.
    covariance : (p, p)
        Covariance of `parameters`, in degrees, mm and the units of lens parameters; (0, 0) if
        unknown.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    cameras: tuple[Camera, ...]
    parameters: tuple[str, ...] = eqx.field(static=True)
    covariance: Float[ArrayLike, "p p"]

    def __init__(
        self,
        cameras: Mapping[str, Camera],
        *,
        parameters: Sequence[str] = (),
        covariance: Float[ArrayLike, "p p"] | None = None,
    ) -> None:
        check_kind(cameras, Mapping, "set of cameras", "a dictionary of names and cameras")
        check_camera_names(cameras)
        for name, camera in cameras.items():
            check_kind(camera, Camera, f'camera "{name}"', "a trinoc.Camera")
        self.names = tuple(cameras)
        self.cameras = tuple(cameras.values())
        check_kind(parameters, (list, tuple), "list of parameters", 'names such as "left.pan_deg"')
        self.parameters = tuple(parameters)
        if covariance is None:
            covariance = np.zeros((0, 0))
        elif not is_traced(covariance):
            covariance = real_array(covariance, "The covariance")
        self.covariance = covariance

    def __check_init__(self) -> None:
        if not self.names:
            raise InputError("A rig needs at least one camera.")
        if self.covariance.shape != (len(self.parameters),) * 2:
            raise InputError(
                f"The covariance has shape {self.covariance.shape}, but there are "
                f"{len(self.parameters)} parameter names. Give one row and one column for each."
            )

    @classmethod
    def from_matrices(
        cls,
        matrices_px: Mapping[str, ArrayLike],
        image_size_px: Sequence[int] | Mapping[str, Sequence[int]],
    ) -> "Rig":
        """Create a rig from any 3x4 projection matrices, in any unit and origin of the world.

        Parameters
        ----------
        matrices_px : dict of (3, 4)
            Projection matrix of each camera, keyed by camera name.
        image_size_px : (width, height), or dict
            One size for all cameras, or a size for each camera name.

        Returns
        -------
        Rig
            Cameras without distortion; no covariance.

        Raises
        ------
        InputError
            If a matrix is no perspective camera or a size is missing. The message names the camera.
        """
        expected = "a dictionary of each camera's name and 3x4 projection matrix"
        check_kind(matrices_px, Mapping, "set of matrices", expected)
        cameras = {}
        for name, matrix in matrices_px.items():
            size: Any = image_size_px
            if isinstance(image_size_px, Mapping):
                size = image_size_px.get(name)
            try:
                cameras[name] = Camera.from_matrix(matrix, size)
            except InputError as error:
                raise InputError(f'Camera "{name}": {error}') from error
        return cls(cameras)

    def take(self, names: Collection[str]) -> "Rig":
        """Return a rig of some of the cameras, with the covariance of their parameters.

        Parameters
        ----------
        names : collection of str
            Names of the cameras.

        Returns
        -------
        Rig
            Cameras in the order of this rig.

        Raises
        ------
        InputError
            If a name is not in the rig.
        """
        check_kind(names, Collection, "set of names", "names of cameras")
        for name in names:
            self[name]
        cameras = {name: camera for name, camera in self.items() if name in names}
        rows = [k for k, each in enumerate(self.parameters) if each.rpartition(".")[0] in cameras]
        return type(self)(
            cameras,
            parameters=[self.parameters[row] for row in rows],
            covariance=np.asarray(self.covariance)[np.ix_(rows, rows)],
        )

    def __getitem__(self, name: str) -> Camera:
        if name not in self.names:
            raise InputError(f'There is no camera "{name}". This rig has {list_names(self)}.')
        return self.cameras[self.names.index(name)]

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def items(self) -> Iterator[tuple[str, Camera]]:
        """Iterate over (name, camera), in the order of `names`."""
        return iter(zip(self.names, self.cameras, strict=True))

    @property
    def matrices_px(self) -> np.ndarray:
        """Projection matrices (v, 3, 4) in the order of `names`, without lens distortion."""
        return np.stack([camera.matrix_px for camera in self.cameras])

    def value(self, parameter: str) -> float:
        """Return the value of a pose parameter.

        Parameters
        ----------
        parameter : str
            A camera name and one of `PARAMETER_NAMES`, such as "upper.pan_deg".

        Returns
        -------
        float
            Value in degrees or mm.

        Raises
        ------
        InputError
            If the name is not a pose parameter of a camera of this rig.
        """
        check_kind(parameter, str, "name of the parameter", 'one such as "left.pan_deg"')
        name, _, parameter_name = parameter.rpartition(".")
        if parameter_name not in PARAMETER_NAMES:
            raise InputError(
                f'A camera has no parameter "{parameter_name}". Use a name such as '
                f'"{self.names[0]}.pan_deg", with one of {", ".join(PARAMETER_NAMES)}.'
            )
        if parameter_name.startswith("aim_"):
            return self[name].aim_mm[0 if parameter_name == "aim_x_mm" else 1]
        return getattr(self[name], parameter_name)

    def covariance_of(self, parameters: Sequence[str]) -> Float[np.ndarray, "k k"]:
        """Covariance (k, k) of the named parameters, in the order of `parameters`.

        Rows and columns of a parameter that the rig's covariance does not contain are zero.
        """
        rows = [self.parameters.index(p) if p in self.parameters else -1 for p in parameters]
        has_row = np.array(rows) >= 0
        covariance = np.asarray(self.covariance)[np.ix_(rows, rows)]
        return np.where(np.outer(has_row, has_row), covariance, 0.0)

    def sigma(self, parameter: str) -> float:
        """Return the standard deviation of a pose or lens parameter.

        Parameters
        ----------
        parameter : str
            A camera name with one of `PARAMETER_NAMES` or with a lens parameter: "upper.pan_deg".

        Returns
        -------
        float
            In degrees, mm or the unit of the lens parameter; NaN if unknown.

        Raises
        ------
        InputError
            If the name is not a parameter of a camera of this rig.
        """
        check_kind(parameter, str, "name of the parameter", 'one such as "left.pan_deg"')
        if parameter not in self.parameters:
            name, _, parameter_name = parameter.rpartition(".")
            if parameter_name not in self[name].intrinsics.lens.parameter_names:
                self.value(parameter)
            return float("nan")
        index = self.parameters.index(parameter)
        return float(np.sqrt(self.covariance[index, index]))


def find_equal_centres(cameras: Mapping[str, Camera]) -> tuple[str, str] | None:
    """Names of the first two cameras with equal centres of projection; None if all differ.

    Centres are equal if their separation is at most a millionth of their distance from the origin.
    """
    names = list(cameras)
    centres = np.array([camera.centre_world_mm for camera in cameras.values()]).reshape(-1, 3)
    distances = np.linalg.norm(centres, axis=1)
    # One row at a time: models of other programs have thousands of cameras.
    for index, name in enumerate(names[:-1]):
        separation_mm = np.linalg.norm(centres[index + 1 :] - centres[index], axis=1)
        nearest_mm = np.maximum(distances[index + 1 :], distances[index])
        is_equal = separation_mm <= _EQUAL_CENTRES * nearest_mm
        if is_equal.any():
            return name, names[index + 1 + int(is_equal.argmax())]
    return None
