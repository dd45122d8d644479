"""Description of a file format of another tool: contents, origins, units and losses."""

import dataclasses
import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError, list_names
from trinoc.geometry.features import Feature
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig, is_camera_name
from trinoc.geometry.segments import Segments
from trinoc.io.atomic import expect_place
from trinoc.io.formats.keys import Keys
from trinoc.io.intrinsics_json import expect_readable
from trinoc.match.features import FEATURES
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.tables import Table

METRE_MM = 1000.0

COVARIANCE = "covariance"
PIXEL_PITCH = "pixel pitch"
WORLD = "world"
LENSES = "lenses"
NAMES = "names"
ORDER = "order"
TRACKS = "tracks"
DETAILS = "details"
LOSSES = {
    COVARIANCE: "the covariance",
    PIXEL_PITCH: "the size of a pixel, and therefore the focal length in mm",
    WORLD: "the world frame: the first camera becomes its origin",
    LENSES: "the lenses",
    NAMES: "the names of the cameras",
    ORDER: "the order of the cameras: files are read in the order of their names",
    TRACKS: "the fragments in the pictures, and the segments that they belong to",
    DETAILS: "polarity, contrast, junctions and chains",
}


def say_losses(value: object, loses: tuple[str, ...]) -> tuple[str, ...]:
    """Return phrases for the data of `value` that a format cannot store, such as "the covariance".

    `loses` contains the keys in `LOSSES` of the data that the format cannot store.
    """
    return tuple(LOSSES[loss] for loss in loses if _has(value, loss))


def _has(value: object, loss: str) -> bool:
    match value:
        case Rig() if loss == COVARIANCE:
            return bool(value.parameters)
        case Rig() if loss == PIXEL_PITCH:
            return any(camera.intrinsics.pixel_pitch_mm is not None for camera in value.cameras)
        case Rig() if loss == WORLD:
            pose = np.asarray(value.cameras[0].cam_from_world)
            return not np.array_equal(pose, np.eye(3, 4))
        case Rig() if loss == ORDER:
            return list(value.names) != sorted(value.names)
        case Rig():
            return True
        case Intrinsics():
            return loss == PIXEL_PITCH and value.pixel_pitch_mm is not None
        case Matches() | Feature():
            return len(value) > 0
        case Segments() if loss == DETAILS:
            return value.junctions is not None or bool(np.any(np.asarray(value.polarity) != 0))
        case Segments():
            return len(value) > 0
    return False


Lenses = Mapping[str, Intrinsics]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Format:
    """A file format of another tool: one file, or a folder of files.

    The default values of the fields describe most formats: lengths in mm or a unit that the caller
    gives, and pixels and axes as in OpenCV.

    Attributes
    ----------
    name : str
        Name of the format in `trinoc export --to` and `--from`.
    title : str
        Name of the format in messages.
    holds : tuple of str
        Kinds of values that can be written: "rig", "lens", "matches", "segments", a kind of feature
        such as "wireframe", or "features" for all of these. Empty for a format that is only read.
    reads : tuple of str
        Kinds of values that can be read. Empty for a format that is only written.
    place : str
        Either "file", "folder", or "file or folder". In the last case a lens is a file and a rig
        is a folder.
    endings : tuple of str
        Accepted endings of the file name; empty if any ending is accepted.
    unit_mm : float or None
        Default length in mm of one unit of the file; None if the format contains no lengths.
    unit_is_fixed : bool
        True if the definition of the format fixes the unit.
    states_unit : bool
        True if each file states its own unit.
    frames : str
        Description of the pixel origin and of the axes, for the documentation.
    loses : tuple of str
        Keys of `LOSSES` for data that the format cannot store. None of them changes a projection.
    write : callable or None
        Function of (value, path, unit_mm) that writes a checked value; None if only read.
    read : callable or None
        Function of (path, unit_mm, lenses) that returns the value; None if only written. For a
        format with `states_unit`, unit_mm is None if the caller does not give a unit.
    keys : mapping of str to Keys
        For each kind of dictionary in a file: the keys that are read, ignored and refused. Empty
        for formats without keys.
    """

    name: str
    title: str
    holds: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    place: str = "file"
    endings: tuple[str, ...] = ()
    unit_mm: float | None = 1.0
    unit_is_fixed: bool = False
    states_unit: bool = False
    frames: str = "pixel (0, 0) is the centre of the top-left pixel; x right, y down, z forward"
    loses: tuple[str, ...] = ()
    write: Callable[[Any, Path, float], None] | None = None
    read: Callable[[Path, Any, Lenses | None], Any] | None = None
    keys: Mapping[str, Keys] = dataclasses.field(default_factory=dict)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of values that can be written; "features" is replaced by the kinds of features."""
        features = tuple(kind.KIND for kind in FEATURES)
        each = (features if kind == "features" else (kind,) for kind in self.holds)
        return tuple(itertools.chain.from_iterable(each))

    def save(
        self, value: object, path: str | os.PathLike[str], *, unit_mm: float | None = None
    ) -> None:
        """Write a value to a file or a folder of this format.

        Parameters
        ----------
        value : Rig, CalibrationResult, Intrinsics, Matches, Segments or Feature
            Of a CalibrationResult, the rig is written; of a lens calibration, the lens.
        path : path
            File or folder to write. It appears complete or not at all.
        unit_mm : float, optional
            Length in mm of one unit of the file, for formats without a fixed unit.

        Raises
        ------
        InputError
            If the format cannot store the value, for example a lens with more distortion
            coefficients, or if the file name has another ending.

        Notes
        -----
        `lost` lists the data that the format does not store, such as the covariance.
        """
        if self.write is None:
            raise InputError(f"{self.title} is only read, not written: choose another format.")
        value = _plain(value)
        kind = _find_kind(value)
        if kind not in self.kinds:
            names = {"rig": "a rig", "lens": "a lens"}
            names |= {each.KIND: each.IN_WORDS for each in (Matches, Segments, *FEATURES)}
            actual = names.get(kind, f"a {type(value).__name__}")
            accepted = " or ".join(names[kind] for kind in self.kinds)
            raise InputError(
                f"{self.title} can contain {accepted}, not {actual}: choose another format."
            )
        target = Path(path)
        if self.place == "folder" or (kind == "rig" and "folder" in self.place):
            expect_new_folder(target)
        else:
            expect_place(target)
            if self.endings and target.suffix.lower() not in self.endings:
                raise InputError(
                    f"{target}: {self.title} is written as {' or '.join(self.endings)}: choose "
                    "such a name."
                )
        _expect_writable(value, target)
        self.write(value, target, self._unit(unit_mm))

    def load(
        self,
        path: str | os.PathLike[str],
        *,
        unit_mm: float | None = None,
        lenses: Lenses | None = None,
        names: Sequence[str] | None = None,
    ) -> Any:
        """Read a Rig, Intrinsics or Segments from a file or a folder of this format.

        Parameters
        ----------
        path : path
            File or folder to read.
        unit_mm : float, optional
            Length in mm of one unit of the file, for formats without a fixed unit.
        lenses : dict of Intrinsics, optional
            Lens of each camera, for formats that contain only poses.
        names : sequence of str, optional
            New names of the cameras of a rig, in the order of the file.

        Returns
        -------
        Rig, Intrinsics or Segments
            A value of one of the kinds in `reads`. A rig has a covariance only if the format stores
            one.

        Raises
        ------
        InputError
            If data is missing or not finite, or does not describe a camera. The message names the
            file.
        """
        if self.read is None:
            raise InputError(f"{self.title} is only written, not read: import another format.")
        source = Path(path)
        if not source.exists():
            raise InputError(f"{source} does not exist: check the name.")
        try:
            stated = self.states_unit and unit_mm is None
            value = self.read(source, None if stated else self._unit(unit_mm), lenses)
        except InputError as error:
            raise error if str(path) in str(error) else InputError(f"{path}: {error}") from error
        if isinstance(value, (Rig, Intrinsics)):
            expect_readable(value, str(source))
        return value if names is None else _rename_cameras(value, tuple(names), source)

    def lost(self, value: object) -> tuple[str, ...]:
        """Return a phrase for each part of `value` that the format does not store.

        None of these parts changes a projection.
        """
        plain = _plain(value)
        lost = say_losses(plain, self.loses)
        is_of_result = isinstance(plain, Intrinsics) and plain is not value
        return (LOSSES[COVARIANCE], *lost) if is_of_result else lost

    def _unit(self, unit_mm: float | None) -> float:
        if unit_mm is None:
            return 1.0 if self.unit_mm is None else self.unit_mm
        if not 0 < unit_mm < float("inf"):
            raise InputError(f"unit_mm is {unit_mm}, but must be the length of a unit in mm.")
        if self.unit_mm is None:
            raise InputError(f"{self.title} contains no lengths: omit unit_mm.")
        if self.unit_is_fixed and unit_mm != self.unit_mm:
            raise InputError(
                f"{self.title} has units of {self.unit_mm:g} mm by definition: omit unit_mm."
            )
        return unit_mm


def expect_new_folder(target: Path) -> None:
    """Raise `InputError` unless `target` is an empty or new folder in an existing folder."""
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{target} exists already: give the name of a new folder.")
    if not target.absolute().parent.is_dir():
        raise InputError(f"The folder {target.parent} does not exist: create it first.")


def _find_kind(value: object) -> str:
    match value:
        case Rig():
            return "rig"
        case Intrinsics():
            return "lens"
        case Table():
            return value.KIND
    return ""


def _plain(value: object) -> object:
    if isinstance(value, (Rig, Intrinsics, Table)):
        return value
    # Here, because it brings the calibrations with it.
    from trinoc.calib.result.calibration import CalibrationResult

    if isinstance(value, CalibrationResult):
        return value.lens if value.is_lens else value.rig
    return value


def _expect_writable(value: object, target: Path) -> None:
    """Raise `InputError` if a value cannot be written as text and read again.

    Text files cannot contain some camera names and numbers that are not finite. Readers also refuse
    unusable lenses and camera positions.
    """
    match value:
        case Rig():
            names, lenses = value.names, [camera.intrinsics for camera in value.cameras]
            numbers = [value.covariance, *(camera.cam_from_world for camera in value.cameras)]
        case Intrinsics():
            names, lenses, numbers = (), [value], []
        case Matches():
            names, lenses, numbers = value.views, [], [value.lines_mm]
        case Feature():
            names, lenses, numbers = (), [], [value.wires().points_mm]
        case _:
            return
    for name in names:
        if not is_camera_name(name):
            raise InputError(
                f"The name of the camera {name!r} cannot be written to a text file: rename the "
                "camera."
            )
    numbers += [array for lens in lenses for array in (lens.lens.parameters, lens.skew_px)]
    if not all(np.isfinite(np.asarray(array)).all() for array in numbers):
        raise InputError(
            f"The {type(value).__name__} has numbers that are not finite: calibrate or match again "
            "so that all are determined."
        )
    if isinstance(value, (Rig, Intrinsics)):
        expect_readable(value, f"{target} was not written")


def _rename_cameras(value: object, names: tuple[str, ...], source: Path) -> Rig:
    if not isinstance(value, Rig):
        raise InputError(f"{source} contains no cameras with names: omit the names.")
    if len(names) != len(value) or len(set(names)) < len(names) or not all(names):
        raise InputError(
            f"{source} holds {len(value)} cameras ({list_names(value)}): give as many "
            "different names."
        )
    new_of = dict(zip(value.names, names, strict=True))
    split = [parameter.rpartition(".") for parameter in value.parameters]
    parameters = [
        f"{new_of.get(camera, camera)}{dot}{parameter_name}"
        for camera, dot, parameter_name in split
    ]
    named = dict(zip(names, value.cameras, strict=True))
    return Rig(named, parameters=parameters, covariance=value.covariance)
