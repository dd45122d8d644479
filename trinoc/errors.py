"""Exceptions that trinoc raises on purpose, and checks of arguments.

TrinocError
├── InputError           an argument is invalid (file, array, name, layout)
├── DetectionError       the sheet was not detected reliably in an image
├── CalibrationError     the observations do not determine the cameras, or the fit failed
└── MatchError           the segments or the rig do not allow matching

A message has one sentence for the cause, with file or argument, and one for the remedy.
"""

import importlib.util
import math
import numbers
import os
from collections.abc import Iterable

# Largest number of names in one sentence: a rig may have hundreds of cameras.
MOST_NAMES = 6


class TrinocError(Exception):
    """Base class of all exceptions that trinoc raises on purpose."""


class InputError(TrinocError, ValueError):
    """An argument, a file or a value in it is invalid."""


class DetectionError(TrinocError):
    """The calibration sheet was not detected in an image, or not reliably."""


class CalibrationError(TrinocError):
    """The observations do not determine the cameras, or the fit failed.

    Attributes
    ----------
    failures : dict of str
        Reason for each failed camera, keyed by camera name.
    result : CalibrationResult or None
        Result of the other cameras; None if no camera was calibrated.
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
    """Join names for a sentence: at most `most` names, then the number of the remaining names."""
    all_names = list(names)
    remaining = len(all_names) - most
    return ", ".join(all_names[:most]) + (f" and {remaining} more" if remaining > 0 else "")


def check_kind(value: object, kinds: type | tuple[type, ...], name: str, wanted: str) -> None:
    """Raise `InputError` if an argument has the wrong type.

    Parameters
    ----------
    value : object
        The argument.
    kinds : type or tuple of types
        Accepted types.
    name : str
        Name of the argument in the message, such as "rig".
    wanted : str
        Description in the message of the argument to give.
    """
    if not isinstance(value, kinds):
        kind = "None" if value is None else f"of type {type(value).__name__}"
        raise InputError(f"The {name} is {kind}. Give {wanted}.")


def whole_number(value: object, name: str) -> int:
    """Convert a whole number, such as 6 or 6.0, to int.

    Raise `InputError` for other values; `name` names the value in the message.
    """
    number = real_number(value, name)
    if number != int(number):
        raise InputError(f"{name} is {value}, but must be a whole number.")
    return int(number)


def real_number(value: object, name: str) -> float:
    """Convert a finite number to float.

    Raise `InputError` for other values, also for texts; `name` names the value in the message.
    """
    if getattr(value, "ndim", None) == 0 and hasattr(value, "item"):
        value = value.item()  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise InputError(f"{name} is {value!r}, but must be a finite number.")
    return float(value)


def expect_path(path: object) -> None:
    """Raise `InputError` if the argument is not a path: a string or `os.PathLike`."""
    check_kind(path, (str, os.PathLike), "name of the file", 'a path, such as "rig.json"')


def expect_extra(library: str, extra: str) -> None:
    """Raise `InputError` if an optional library is not installed.

    The message gives the install command with the name of the package's extra.
    """
    if importlib.util.find_spec(library) is None:
        raise InputError(f"This needs {library}. Run pip install 'trinoc[{extra}]'.")
