"""Arguments NAME=FILE: one file for each camera."""

from collections.abc import Sequence
from pathlib import Path

from trinoc.cli.command import UsageError


def files_of_views(arguments: Sequence[str]) -> dict[str, Path]:
    """The file of each view, in the order given. Raises UsageError."""
    files: dict[str, Path] = {}
    for argument in arguments:
        name, separator, file = argument.partition("=")
        if not (name and separator and file):
            raise UsageError(
                f'"{argument}" names no view: write NAME=FILE, such as upper=upper.png.'
            )
        if name in files:
            raise UsageError(f'The view "{name}" is given twice: name each camera once.')
        files[name] = Path(file)
    return files
