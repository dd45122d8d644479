"""Results go where nothing is lost: not over each other, and not over what is read."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

from trinoc.cli.command import UsageError

# Options of commands that name a file to write; all other paths are read.
_WRITTEN = ("out", "report", "cylinders", "rims_out", "plot")
# A rig may take the place of the one that it was made from.
_REPLACED = ("rig", "orientation")


def expect_places(command: object) -> None:
    """Raise UsageError where two results, or a result and what it is made of, are one file."""
    taken: dict[Path, str] = {}
    kept = {_same(path) for path in _read(command, (*_WRITTEN, *_REPLACED))}
    read = {_same(path) for path in _read(command, _WRITTEN)}
    for name in _WRITTEN:
        path = getattr(command, name, None)
        if not isinstance(path, Path):
            continue
        option, place = f"--{name.replace('_', '-')}", _same(path)
        if place in (kept if name == "out" else read):
            raise UsageError(
                f"{option} is {path}, which is read, and would be lost: give another name."
            )
        if place in taken:
            raise UsageError(
                f"{taken[place]} and {option} are both {path}: give each a name of its own."
            )
        taken[place] = option


def _read(options: object, but: tuple[str, ...]) -> Iterator[Path]:
    """Files that options name, those of groups of options and of NAME=FILE, too."""
    for field in dataclasses.fields(options):  # pyright: ignore[reportArgumentType]
        value = getattr(options, field.name)
        if field.name in but:
            continue
        if dataclasses.is_dataclass(value):
            yield from _read(value, but)
        for each in value if isinstance(value, tuple) else (value,):
            if isinstance(each, Path):
                yield each
            elif isinstance(each, str) and each:
                yield Path(each.partition("=")[2] or each)


def _same(path: Path) -> Path:
    """One path for all names of a file; a name that no file can have stays as it is."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):
        return path
