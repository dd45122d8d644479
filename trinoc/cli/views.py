"""Arguments NAME=FILE, or FILE alone: one file for each camera."""

from collections.abc import Collection, Sequence
from pathlib import Path

from trinoc.cli.command import UsageError
from trinoc.cli.progress import LOGGER

# What stands between the words of a file's name.
_BETWEEN = "_-. "


def files_of_views(
    arguments: Sequence[str], *, guess: bool = False, say: bool = True
) -> dict[str, Path]:
    """The file of each view, in the order given.

    guess : where no name is given at all, take them from the files' names; say : and say so.

    Raises UsageError.
    """
    named = [argument.partition("=") for argument in arguments]
    if guess and arguments and all(not separator for _, separator, _ in named):
        return _guessed([Path(argument) for argument in arguments], say=say)
    files: dict[str, Path] = {}
    for argument, (name, separator, file) in zip(arguments, named, strict=True):
        if not (name and separator and file):
            raise UsageError(
                f'"{argument}" names no view: write NAME=FILE, such as upper=upper.png.'
            )
        if name in files:
            raise UsageError(f'The view "{name}" is given twice: name each camera once.')
        files[name] = Path(file)
    return files


def _guessed(files: Sequence[Path], *, say: bool) -> dict[str, Path]:
    """Named after what differs between the files' names, or the folders' where the names agree."""
    for words in ([file.stem for file in files], [file.parent.name for file in files]):
        names = _differing(words)
        if all(names) and len(set(names)) == len(names):
            found = dict(zip(names, files, strict=True))
            if say:
                said = " ".join(f"{name}={file}" for name, file in found.items())
                LOGGER.info("cameras are named after their files: %s", said)
            return found
    raise UsageError(
        f"The names of the files do not tell cameras apart: write NAME=FILE, such as "
        f"upper={files[0]}."
    )


def _differing(words: Sequence[str]) -> list[str]:
    """The words without what all begin and end with, cut where a part of a name ends."""
    if len(words) == 1:
        return list(words)
    begin = _whole_parts(_common_start(words))
    rest = [word[len(begin) :] for word in words]
    end = _whole_parts(_common_start([word[::-1] for word in rest]))
    return [word[: len(word) - len(end)] for word in rest]


def _common_start(words: Sequence[str]) -> str:
    """The letters that all words begin with."""
    first, last = min(words), max(words)
    count = next((k for k, pair in enumerate(zip(first, last)) if pair[0] != pair[1]), len(first))
    return first[:count]


def _whole_parts(shared: str) -> str:
    """As far as the last sign between parts: "sheet_l" of sheet_left, sheet_low is "sheet_"."""
    last = max(shared.rfind(sign) for sign in _BETWEEN)
    return shared[: last + 1]


def files_of_rig(arguments: Sequence[str], names: Collection[str]) -> dict[str, Path]:
    """Files for the cameras of a rig: where no name is given, by the rig's own where these tell.

    Raises UsageError.
    """
    files = files_of_views(arguments, guess=True)
    if set(files) <= set(names) or any("=" in argument for argument in arguments):
        return files
    found = {}
    for file in files.values():
        inside = [name for name in names if name.lower() in file.stem.lower()]
        if len(inside) != 1 or inside[0] in found:
            return files
        found[inside[0]] = file
    LOGGER.info("by the rig: %s", " ".join(f"{name}={file}" for name, file in found.items()))
    return found
