"""Command-line words as options: settings written NAME=VALUE, and the file trinoc.toml.

Each table of the file is a command. A key is the name of an option, and `images` holds the files of
the cameras:

    [calibrate]
    images = {upper = "sheet/upper.png", left = "sheet/left.png", right = "sheet/right.png"}
    board = "sheet.json"
    lens_mm = [16, 0.0162, 0.0134]
    sigma = {flatness_mm = 0.1}

    [match]
    images = {upper = "upper.png", left = "left.png", right = "right.png"}
"""

import difflib
import math
import tomllib
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trinoc.cli.command import UsageError
from trinoc.cli.options import REPEATED, Settings, list_options

# For each name what makes a value of its text. It raises ValueError, whose words complete a
# sentence.
Parsers = Mapping[str, Callable[[str], Any]]


def read_settings(option: str, words: Iterable[Iterable[str]], parsers: Parsers) -> dict[str, Any]:
    """Settings NAME=VALUE of an option, parsed, by name.

    Raises UsageError for an unknown name, a name without a value or given twice, and an invalid
    value.

    words : arguments of each occurrence of the option.
    parsers : function for each name that converts the text of the value.
    """
    values: dict[str, Any] = {}
    for word in (word for group in words for word in group):
        name, separator, text = word.partition("=")
        name = name.replace("-", "_")
        if name not in parsers:
            close_names = difflib.get_close_matches(name, parsers, n=1)
            advice = (
                f"write {close_names[0]}=VALUE"
                if close_names
                else f"the settings are {', '.join(parsers)}"
            )
            files = "; write files before the options" if option.startswith("--") else ""
            raise UsageError(f'{option} has no setting "{name}": {advice}{files}.')
        if not (separator and text):
            raise UsageError(f"{option} {word} has no value: write {name}=VALUE.")
        if name in values:
            raise UsageError(f"{option} has {name} twice: give it once.")
        try:
            values[name] = parsers[name](text)
        except ValueError as error:
            raise UsageError(f"{option} {word} {error}.") from error
    return values


def put_files_first(command: Callable[..., Any], arguments: Sequence[str]) -> list[str]:
    """Move every NAME=FILE argument that stands between options to the front.

    The value of an option stays behind the option: one word, or its settings NAME=VALUE. Options
    with several numbers also accept one word with commas.
    """
    kinds = {option.typed: option.kind for option in list_options(command)}
    flags = {option for option, kind in kinds.items() if kind is bool}
    with_settings = {option for option, kind in kinds.items() if kind == Settings}
    lengths = {option: _count_numbers(kind) for option, kind in kinds.items()}
    first, rest, option, is_taken = [], [], "", False
    for word in arguments:
        if word.startswith("-"):
            option, is_taken = word, word not in flags and "=" not in word
        elif "=" in word and not is_taken and option not in with_settings:
            first.append(word)
            continue
        else:
            is_taken = False
        values = word.split(",")
        rest += values if 1 < len(values) == lengths.get(option) else [word]
    # A word alone before all options, such as the kind of a board, stays before what goes with it.
    count = next((k for k, word in enumerate(rest) if word.startswith("-")), len(rest))
    return [*rest[:count], *first, *rest[count:]]


def _count_numbers(kind: Any) -> int:
    """Number of values of an option whose type is a tuple of floats; 0 for other types."""
    alternatives = map(typing.get_args, (kind, *typing.get_args(kind)))
    return next((len(values) for values in alternatives if set(values) == {float}), 0)


def parse_number(text: str) -> float:
    """Convert a text to a finite number. Raises ValueError."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError("is no number: give a finite number")
    return number


def parse_integer(text: str) -> int:
    """Convert a text to a whole number. Raises ValueError."""
    number = parse_number(text)
    if number != int(number):
        raise ValueError("is no whole number: give one")
    return int(number)


def parse_truth(text: str) -> bool:
    """Convert "yes" or "no" to a truth value. Raises ValueError."""
    truths = {"yes": True, "true": True, "no": False, "false": False}
    if text.lower() not in truths:
        raise ValueError("is neither yes nor no: give one of them")
    return truths[text.lower()]


def parse_pair(parse: Callable[[str], Any]) -> Callable[[str], tuple[Any, Any]]:
    """Return a parser of two values, such as 1280,960 or 1280x960, made from a parser of one value.

    If the text has a single value, the pair contains it twice.
    """

    def parse_two(text: str) -> tuple[Any, Any]:
        values = [parse(each) for each in text.replace("x", ",").split(",")]
        if len(values) > 2:
            raise ValueError("has more than two values: give one, or two with a comma between")
        return values[0], values[-1]

    return parse_two


def parse_word(*words: str) -> Callable[[str], str]:
    """Return a parser that accepts only these words."""

    def parse_one(text: str) -> str:
        if text not in words:
            raise ValueError(f"is unknown: give {', '.join(words[:-1])} or {words[-1]}")
        return text

    return parse_one


SETTINGS_FILE = Path("trinoc.toml")
# An option on the command line replaces every option of its group in the file.
ALTERNATIVES = (
    ("--out", "-o"),
    ("--board", "--pattern"),
    ("--rig", "--lens", "--intrinsics", "--lens-mm"),
    ("--to", "--from"),
)


def with_file(arguments: Sequence[str], file: Path = SETTINGS_FILE) -> list[str]:
    """Return the arguments, with values from a settings file for options that are not given.

    Raises UsageError if the file cannot be read.

    arguments : files before options, as `put_files_first` returns them.
    """
    if not arguments or {"--help", "-h"} & set(arguments) or not file.is_file():
        return list(arguments)
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8-sig")).get(arguments[0])
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"{file} cannot be read ({error}): correct it there.") from error
    if not isinstance(table, dict):
        return list(arguments)
    command, *typed = arguments
    typed_options = {word.partition("=")[0] for word in typed}
    images: list[str] = []
    options: list[str] = []
    for key, value in table.items():
        option = f"--{key.replace('_', '-')}"
        group = next((group for group in ALTERNATIVES if option in group), (option,))
        if key == "images":
            images = [] if typed and not typed[0].startswith("-") else _words(value)
        elif typed_options.isdisjoint(group):
            options += _option_words(option, value)
    return [command, *images, *typed, *options]


def _option_words(option: str, value: object) -> list[str]:
    """Option and its value as words of a command line."""
    if isinstance(value, bool):
        return [option] if value else []
    if option[2:] in REPEATED:
        return [each for word in _words(value) for each in (option, word)]
    return [option, *_words(value)]


def _words(value: object) -> list[str]:
    """Value as words of a command line: a table becomes NAME=VALUE, a list one word per item."""
    if isinstance(value, dict):
        return [f"{name}={_word(each)}" for name, each in value.items()]
    return [str(each) for each in value] if isinstance(value, list) else [str(value)]


def _word(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
