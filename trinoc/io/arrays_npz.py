"""npz files with a name and a version of their format, read without trusting what is in them."""

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write


def write_arrays(
    path: str | os.PathLike[str], format_name: str, version: int, arrays: dict[str, np.ndarray]
) -> None:
    """Write arrays, whole or not at all, beside the format's name and version."""
    named: dict[str, Any] = {"format": np.array(format_name), "version": np.array(version)}
    named.update(arrays)
    with atomic_write(path) as file:
        np.savez_compressed(file, **named)


def read_arrays(
    path: str | os.PathLike[str], format_name: str, version: int
) -> dict[str, np.ndarray]:
    """The arrays of a file that `write_arrays` wrote.

    Raises InputError for a file that is missing or broken, or of another format or version.
    """
    file = Path(path)
    arrays = _arrays(file)
    found = str(arrays.pop("format", ""))
    if found != format_name:
        raise InputError(
            f'{file} has the format "{found}", but "{format_name}" is needed: give another file.'
        )
    found_version = arrays.pop("version", None)
    if found_version is None or int(found_version) != version:
        raise InputError(
            f"{file} has version {found_version} of {format_name}, but this trinoc reads version "
            f"{version}: update trinoc or write the file again."
        )
    return arrays


def format_of_arrays(path: str | os.PathLike[str]) -> str:
    """The format that a file of `write_arrays` states. Raises InputError as `read_arrays` does."""
    return str(_arrays(Path(path), ("format",)).get("format", ""))


def take(arrays: dict[str, np.ndarray], name: str, path: str | os.PathLike[str]) -> np.ndarray:
    """One array by name. Raises InputError where the file lacks it."""
    if name not in arrays:
        raise InputError(f'{path} lacks the array "{name}": write the file again.')
    return arrays[name]


def _arrays(file: Path, only: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
    try:
        with np.load(file, allow_pickle=False) as archive:
            names = [name for name in archive.files if only is None or name in only]
            return {name: archive[name] for name in names}
    except FileNotFoundError as error:
        raise InputError(f"{file} does not exist: check the name.") from error
    except (OSError, ValueError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{file} is not a readable npz file: give a file that trinoc wrote, or write it again."
        ) from error
