"""Several cameras in one world frame, with what is known of their errors."""

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

# Centres nearer to each other than this share of their distance from the sheet are one place.
_ONE_PLACE = 1e-6
# Names that folders give to themselves and to what is above them.
_NO_NAMES = (".", "..")
# What to give where a rig is wanted.
A_RIG = "a trinoc.Rig, such as load_rig reads from a file"
PARAMETER_NAMES = (*POSE_NAMES, "aim_x_mm", "aim_y_mm")


def is_camera_name(name: object) -> bool:
    """Whether files, tables and messages can hold a name: printable characters, not all blank."""
    text = isinstance(name, str)
    return text and name.isprintable() and bool(name.strip()) and name not in _NO_NAMES


def check_camera_names(names: Iterable[object]) -> None:
    """Raise InputError for a name that a camera cannot have."""
    for name in names:
        if not is_camera_name(name):
            raise InputError(
                f"A camera is named {name!r}: give it a name of printable characters, which is not "
                "blank, . or .. alone."
            )


class Rig(Displayable, Value):
    """Named cameras, in the order the user gave them.

    Fields
    ------
    names : name of each camera.
    cameras : the cameras, in the order of `names`.
    parameters : names ("upper.pan_deg", ...) of the rows of `covariance`; empty if unknown.
    covariance : (p, p) of `parameters`, in degrees and mm; (0, 0) if unknown.
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
                f"The covariance is {self.covariance.shape}, but {len(self.parameters)} "
                "parameters are named: give one row and one column for each."
            )

    @classmethod
    def from_matrices(
        cls,
        matrices_px: Mapping[str, ArrayLike],
        image_size_px: Sequence[int] | Mapping[str, Sequence[int]],
    ) -> "Rig":
        """A rig from any 3x4 projection matrices, in any unit and origin of the world.

        `image_size_px` is one (width, height), or one per camera. Raises InputError.
        """
        each = "a dictionary of each camera's name and 3x4 projection matrix"
        check_kind(matrices_px, Mapping, "set of matrices", each)
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
        """The rig of some of its cameras, in its own order, with their part of the covariance.

        Raises InputError for a name that is no camera of it.
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
            raise InputError(f'There is no camera "{name}"; this rig has {list_names(self)}.')
        return self.cameras[self.names.index(name)]

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def items(self) -> Iterator[tuple[str, Camera]]:
        """(name, camera) in order."""
        return iter(zip(self.names, self.cameras, strict=True))

    @property
    def matrices_px(self) -> np.ndarray:
        """(v, 3, 4) projection matrices in the order of `names`, without lens distortion."""
        return np.stack([camera.matrix_px for camera in self.cameras])

    def value(self, parameter: str) -> float:
        """A parameter of `PARAMETER_NAMES` such as "upper.pan_deg", in degrees or millimetres.

        Raises InputError for another name.
        """
        check_kind(parameter, str, "name of the parameter", 'one such as "left.pan_deg"')
        name, _, own = parameter.rpartition(".")
        if own not in PARAMETER_NAMES:
            raise InputError(
                f'A camera has no parameter "{own}": ask for one such as "{self.names[0]}.pan_deg" '
                f"of {', '.join(PARAMETER_NAMES)}."
            )
        if own.startswith("aim_"):
            return self[name].aim_mm[0 if own == "aim_x_mm" else 1]
        return getattr(self[name], own)

    def covariance_of(self, parameters: Sequence[str]) -> Float[np.ndarray, "k k"]:
        """(k, k) of some parameters by name; zero for what `covariance` does not hold."""
        rows = [self.parameters.index(p) if p in self.parameters else -1 for p in parameters]
        known = np.array(rows) >= 0
        chosen = np.asarray(self.covariance)[np.ix_(rows, rows)]
        return np.where(np.outer(known, known), chosen, 0.0)

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter such as "upper.pan_deg"; NaN if not known.

        Raises InputError for a name that is neither of `PARAMETER_NAMES` nor the lens's.
        """
        check_kind(parameter, str, "name of the parameter", 'one such as "left.pan_deg"')
        if parameter not in self.parameters:
            name, _, own = parameter.rpartition(".")
            if own not in self[name].intrinsics.lens.parameter_names:
                self.value(parameter)
            return float("nan")
        index = self.parameters.index(parameter)
        return float(np.sqrt(self.covariance[index, index]))


def at_one_place(cameras: Mapping[str, Camera]) -> tuple[str, str] | None:
    """The names of two cameras that stand at one place; None where there are none."""
    names = list(cameras)
    centres = np.array([camera.centre_world_mm for camera in cameras.values()]).reshape(-1, 3)
    distances = np.linalg.norm(centres, axis=1)
    # One row at a time: models of other programs have thousands of cameras.
    for number, name in enumerate(names[:-1]):
        apart = np.linalg.norm(centres[number + 1 :] - centres[number], axis=1)
        beside = apart <= _ONE_PLACE * np.maximum(distances[number + 1 :], distances[number])
        if beside.any():
            return name, names[number + 1 + int(beside.argmax())]
    return None
