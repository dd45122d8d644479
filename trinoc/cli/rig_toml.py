"""trinoc.toml: what the commands of one rig are always told, so that they need no arguments.

Each table is a command, each key one of its options, `images` the files of its cameras:

    [calibrate]
    images = {upper = "sheet/upper.png", left = "sheet/left.png", right = "sheet/right.png"}
    board = "sheet.json"
    lens_mm = [16, 0.0162, 0.0134]
    sigma = {flatness_mm = 0.1}

    [match]
    images = {upper = "upper.png", left = "left.png", right = "right.png"}
    rig = "rig.json"
"""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trinoc.cli.command import UsageError
from trinoc.cli.old_names import KEYS

FILE = Path("trinoc.toml")
POSITIONAL = "images"
# Of each group one counts: what is typed.
ONE_OF = (
    ("--out", "-o"),
    ("--board", "--pattern"),
    ("--lens", "--intrinsics", "--lens-mm"),
    ("--to", "--from"),
)
# These take one value each time they are given.
REPEATED = ("--board", "--pattern", "--lens", "--intrinsics")


def with_file(arguments: Sequence[str], file: Path = FILE) -> list[str]:
    """The arguments with what the file says of their command; what is typed counts more.

    arguments : files before options, as `put_files_first` has them.

    Raises UsageError for a file that cannot be read, and a key of before.
    """
    if not arguments or "--help" in arguments or "-h" in arguments or not file.is_file():
        return list(arguments)
    table = _read(file).get(arguments[0])
    if not isinstance(table, dict):
        return list(arguments)
    command, typed = arguments[0], list(arguments[1:])
    added: list[str] = []
    for key, value in table.items():
        option = f"--{key.replace('_', '-')}"
        if key in KEYS:
            raise UsageError(f"{file}: {key} is now: {KEYS[key]}")
        if key == POSITIONAL:
            is_typed = bool(typed) and not typed[0].startswith("-")
            positional = [] if is_typed else _files(value, file)
            typed = [*positional, *typed]
        elif not _says(option, typed):
            added += _words(option, value, file)
    return [command, *typed, *added]


def _read(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"{file} cannot be read ({error}): correct it there.") from error


def _says(option: str, typed: Sequence[str]) -> bool:
    same = next((group for group in ONE_OF if option in group), (option,))
    return any(word.partition("=")[0] in same for word in typed)


def _files(value: object, file: Path) -> list[str]:
    if isinstance(value, dict):
        return [f"{name}={path}" for name, path in value.items()]
    if isinstance(value, list):
        return [str(path) for path in value]
    raise UsageError(
        f'{file}: "{POSITIONAL}" must be a table of names and files, such as '
        '{upper = "upper.png"}, or a list of files.'
    )


def _words(option: str, value: object, file: Path) -> list[str]:
    if isinstance(value, bool):
        return [option] if value else []
    if isinstance(value, dict):
        return [w for name, each in value.items() for w in (option, f"{name}={_word(each)}")]
    if isinstance(value, list) and option in REPEATED:
        return [word for each in value for word in (option, _word(each))]
    if isinstance(value, list):
        return [option, *map(_word, value)]
    if isinstance(value, (str, int, float)):
        return [option, _word(value)]
    raise UsageError(
        f'{file}: "{option[2:]}" must be a text, a number, true, false, a list or a table.'
    )


def _word(value: object) -> str:
    """As it is typed."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ",".join(map(_word, value)) if isinstance(value, list) else str(value)
