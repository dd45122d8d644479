"""Checks of the options of any command before its work: numbers, and files that would be lost."""

import inspect
import math
from pathlib import Path
from typing import Any

from trinoc.cli.command import UsageError

# Options that name a file to write; all other paths are read.
_WRITTEN = ("out", "report")
# A rig may take the place of the one that it was made from.
_REPLACED = ("rig", "orientation")
# Every report has it: a file without it is not one to replace.
_MARK = b"<!doctype html>"


def expect_options(call: inspect.BoundArguments) -> None:
    """Check the options of a command before it runs.

    Raises UsageError if a number is not finite, or if an output file is also an input or another
    output. Raises InputError if a report would replace another kind of file.
    """
    options, parameters = call.arguments, call.signature.parameters
    for name, value in options.items():
        _expect_numbers(name, value, parameters[name].default)
    option_of_output: dict[Path, str] = {}
    for name in _WRITTEN:
        path = options.get(name)
        if not isinstance(path, Path):
            continue
        output = _resolve(path)
        ignored = (*_WRITTEN, *(_REPLACED if name == "out" else ()))
        if any(
            output in _paths(value) for option, value in options.items() if option not in ignored
        ):
            raise UsageError(
                f"--{name} is {path}, which is an input and would be overwritten: give another "
                "name."
            )
        if output in option_of_output:
            raise UsageError(
                f"--{option_of_output[output]} and --{name} are both {path}: give each output its "
                "own name."
            )
        option_of_output[output] = name
        if name == "report":
            _expect_report(path, force=options["job"].force)


def _expect_report(path: Path, *, force: bool) -> None:
    from trinoc.io.saving import expect_marked

    if path.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--report is {path}: a report is HTML, choose a name such as r.html.")
    expect_marked(path, _MARK, force=force)


def _expect_numbers(name: str, value: Any, default: Any) -> None:
    """Raise UsageError for NaN, and for infinity unless the default value contains it."""
    default_numbers = default if isinstance(default, tuple) else (default,)
    for number in value if isinstance(value, tuple) else (value,):
        if (
            isinstance(number, float)
            and not math.isfinite(number)
            and number not in default_numbers
        ):
            raise UsageError(f"--{name.replace('_', '-')} is {number}: give a finite number.")


def _paths(value: Any) -> set[Path]:
    """Files in the value of an option, given as paths or as NAME=FILE."""
    values = value if isinstance(value, tuple) else (value,)
    files = [word.partition("=")[2] or word if isinstance(word, str) else word for word in values]
    return {_resolve(Path(file)) for file in files if file and isinstance(file, str | Path)}


def _resolve(path: Path) -> Path:
    """Absolute path of a file without symbolic links; the path itself if no file can have this
    name.
    """
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):
        return path
