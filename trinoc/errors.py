"""Everything trinoc raises on purpose.

TrinocError
├── InputError           what the caller handed in cannot be used (file, array, name, layout)
├── DetectionError       no answer about the sheet in a picture can be trusted
├── CalibrationError     the observations do not determine the cameras, or the fit failed
└── MatchError           the segments or the rig do not allow matching

Each message is one sentence that says what is wrong, where, and what to do next.
"""

import importlib.util
import math
import numbers
import os
from collections.abc import Iterable

# Names of cameras in one sentence: a rig may have hundreds.
MOST_NAMES = 6


class TrinocError(Exception):
    """Base of every error that trinoc raises on purpose."""


class InputError(TrinocError, ValueError):
    """What the caller handed in cannot be used."""


class DetectionError(TrinocError):
    """The sheet was not found in a picture, or was found in a way that cannot be trusted."""


class CalibrationError(TrinocError):
    """The observations do not determine the cameras, or the fit failed.

    `failures` maps each failed camera to its sentence; `result` is the CalibrationResult of
    the other cameras, or None where there is none.
    """

    def __init__(
        self, message: str, failures: dict[str, str] | None = None, result: object = None
    ) -> None:
        super().__init__(message)
        self.failures = failures or {}
        self.result = result


class MatchError(TrinocError):
    """The segments or the rig do not allow matching."""


def list_names(names: Iterable[str], most: int = MOST_NAMES) -> str:
    """Names for a sentence; of more than `most` the first ones and the number of the others."""
    every = list(names)
    more = len(every) - most
    return ", ".join(every[:most]) + (f" and {more} more" if more > 0 else "")


def check_kind(value: object, kinds: type | tuple[type, ...], name: str, wanted: str) -> None:
    """Raise InputError where an argument is of another kind than those that a function takes.

    `name` is what the argument is called, such as "rig"; `wanted` what to give.
    """
    if not isinstance(value, kinds):
        kind = "None" if value is None else f"of type {type(value).__name__}"
        raise InputError(f"The {name} is {kind}: give {wanted}.")


def whole_number(value: object, name: str) -> int:
    """A whole number that a caller gave, also as 6.0. Raises InputError for others."""
    number = real_number(value, name)
    if number != int(number):
        raise InputError(f"{name} is {value}, but must be a whole number.")
    return int(number)


def real_number(value: object, name: str) -> float:
    """A finite number that a caller gave. Raises InputError for others and for texts."""
    if getattr(value, "ndim", None) == 0 and hasattr(value, "item"):
        value = value.item()  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise InputError(f"{name} is {value!r}, but must be a finite number.")
    return float(value)


def expect_path(path: object) -> None:
    """Raise InputError where a caller gave something else than the name of a file or folder."""
    check_kind(path, (str, os.PathLike), "name of the file", 'a path, such as "rig.json"')


def expect_extra(library: str, extra: str) -> None:
    """Raise InputError, with the command that installs it, where a library is missing."""
    if importlib.util.find_spec(library) is None:
        raise InputError(f"This needs {library}: pip install 'trinoc[{extra}]'.")
