"""Options that hold several settings, each written NAME=VALUE: --find, --sigma and their kin."""

import difflib
import math
import re
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any

import tyro

from trinoc.cli.command import UsageError

# May be given again, or with several settings behind it.
Settings = Annotated[
    tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]],
    tyro.conf.arg(metavar="NAME=VALUE...", help_behavior_hint="(optional)"),
]
# For each name what makes a value of its text. It raises ValueError, whose words complete a
# sentence.
Parsers = Mapping[str, Callable[[str], Any]]


def read_settings(option: str, words: Iterable[Iterable[str]], parsers: Parsers) -> dict[str, Any]:
    """The settings that an option states, by name.

    Raises UsageError for a name that the option does not have, one without a value or given twice,
    and a value that its parser refuses.
    """
    found: dict[str, Any] = {}
    for word in (word for group in words for word in group):
        name, separator, text = word.partition("=")
        name = name.replace("-", "_")
        if name not in parsers:
            near = difflib.get_close_matches(name, parsers, n=1)
            known = f"write {near[0]}=VALUE" if near else f"it has {', '.join(parsers)}"
            files = "; files stand before the options" if option.startswith("--") else ""
            raise UsageError(f'{option} has no setting "{name}": {known}{files}.')
        if not (separator and text):
            raise UsageError(f"{option} {word} has no value: write {name}=VALUE.")
        if name in found:
            raise UsageError(f"{option} has {name} twice: give it once.")
        try:
            found[name] = parsers[name](text)
        except ValueError as error:
            raise UsageError(f"{option} {word} {error}.") from error
    return found


def put_files_first(command: type, words: Sequence[str]) -> list[str]:
    """The words behind a command, with every NAME=FILE that stands between options moved before.

    What an option takes stays behind it: the one word that follows it, and settings.
    """
    hints = typing.get_type_hints(command, include_extras=True)
    flags = {f"--{name.replace('_', '-')}" for name, hint in hints.items() if hint is bool}
    with_settings = {f"--{name}" for name, hint in hints.items() if hint == Settings}
    first, rest, option, is_taken = [], [], "", False
    for word in words:
        if word.startswith("-"):
            option, is_taken = word, word not in flags and "=" not in word
        elif "=" in word and not is_taken and option not in with_settings:
            first.append(word)
            continue
        else:
            is_taken = False
        rest.append(word)
    # A word alone before all options, such as the kind of a board, stays before what goes with it.
    count = next((k for k, word in enumerate(rest) if word.startswith("-")), len(rest))
    return [*rest[:count], *first, *rest[count:]]


def parse_number(text: str) -> float:
    """A finite number."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError("is no number: give a finite number")
    return number


def parse_integer(text: str) -> int:
    """A whole number."""
    number = parse_number(text)
    if number != int(number):
        raise ValueError("is no whole number: give one")
    return int(number)


def parse_truth(text: str) -> bool:
    """yes or no."""
    words = {"yes": True, "true": True, "no": False, "false": False}
    if text.lower() not in words:
        raise ValueError("is neither yes nor no: give one of them")
    return words[text.lower()]


def parse_list(parse: Callable[[str], Any]) -> Callable[[str], tuple[Any, ...]]:
    """Of the parser of one value that of several with commas between."""
    return lambda text: tuple(parse(each) for each in text.split(","))


def parse_pair(parse: Callable[[str], Any]) -> Callable[[str], tuple[Any, Any]]:
    """Of the parser of one value that of two, written 1280,960 or 1280x960; one stands for both."""

    def parse_two(text: str) -> tuple[Any, Any]:
        values = [parse(each) for each in re.split("[,x]", text)]
        if len(values) > 2:
            raise ValueError("has more than two values: give one, or two with a comma between")
        return values[0], values[-1]

    return parse_two


def parse_word(*words: str) -> Callable[[str], str]:
    """The parser of one word of these."""

    def parse_one(text: str) -> str:
        if text not in words:
            raise ValueError(f"is unknown: give {', '.join(words[:-1])} or {words[-1]}")
        return text

    return parse_one
