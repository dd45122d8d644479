"""The lists of options of reference.md, as commands declare them: docs/make_reference.py"""

import ast
import dataclasses
import inspect
import re
import textwrap
import typing
from pathlib import Path
from typing import Any, Literal

import tyro

from trinoc.cli.command import Command
from trinoc.cli.main import COMMANDS

PAGE = Path(__file__).parent / "reference.md"
# Of all commands, and said of all of them above the first.
_SHARED = {field.name for field in dataclasses.fields(Command)}


def with_options(page: str) -> str:
    """The page with the options of every command as its class declares them."""
    first: dict[tuple[str, str], str] = {}
    for name in re.findall(r"^### `trinoc ([\w-]+)`", page, re.M):
        options = _options(COMMANDS[name])
        whole = "".join(f"- {words}\n" for words in _listed(name, options, first))
        section = rf"(### `trinoc {name}`\n(?:(?!### |- `).*\n)*?)(?:- `.*\n)+"
        page, found = re.subn(section, lambda match, own=whole: match[1] + own, page)
        assert found == 1, f"{PAGE.name} has no list of options of {name}"
    return page


def _listed(
    command: str, options: list[tuple[str, str]], first: dict[tuple[str, str], str]
) -> list[str]:
    """A line for each option; those that an earlier command has alike share one, at the end."""
    lines, shared = [], {}
    for option, words in options:
        owner = first.setdefault((option, words), command)
        if owner == command:
            lines.append(f"{option}: {words}")
        else:
            shared.setdefault(owner, []).append(option)
    return lines + [f"{', '.join(own)}: as of `trinoc {owner}`" for owner, own in shared.items()]


def _options(options: type) -> list[tuple[str, str]]:
    """(how it is typed, what it says) of each option, those of groups of options, too."""
    sentences, found = _sentences(options), []
    hints = typing.get_type_hints(options, include_extras=True)
    for field in dataclasses.fields(options):
        hint, said = hints[field.name], list(getattr(hints[field.name], "__metadata__", ()))
        while hasattr(hint, "__metadata__"):
            hint = typing.get_args(hint)[0]
        if dataclasses.is_dataclass(hint):
            found += _options(typing.cast(type, hint))
        elif field.name not in _SHARED:
            given = next((each.help for each in said if getattr(each, "help", None)), None)
            words = [given or sentences[field.name], _default(field, said)]
            name = f"no_{field.name}" if field.default is True else field.name
            found.append((_typed(name, hint, said), " ".join(filter(None, words))))
    return sorted(found, key=lambda row: row[0].startswith("`-"))


def _typed(name: str, hint: Any, said: list[Any]) -> str:
    """The option with its short form, what is typed behind it, and its other name."""
    metavar = next((each.metavar for each in said if getattr(each, "metavar", None)), "")
    if tyro.conf.Positional in said:
        return f"`{metavar}`"
    members = typing.get_args(hint) if typing.get_origin(hint) is not Literal else (hint,)
    choices = [typing.get_args(each) for each in members if typing.get_origin(each) is Literal]
    behind = metavar or "|".join(str(choice) for own in choices for choice in own)
    short = next((each.aliases for each in said if getattr(each, "aliases", None)), ())
    name = next((each.name for each in said if getattr(each, "name", None)), name)
    option = f"--{name.replace('_', '-')} {behind}".strip()
    names = sorted((*short, option), key=lambda each: (each.startswith("--"), each != option))
    return ", ".join(f"`{each}`" for each in names)


def _default(field: dataclasses.Field, said: list[Any]) -> str:
    hint = next((h for each in said if (h := getattr(each, "help_behavior_hint", None))), None)
    if isinstance(hint, str):
        return "" if hint in ("(default: none)", "(optional)") else hint
    if field.default is dataclasses.MISSING:
        return "(required)"
    if field.default in (None, False, ()):
        return ""
    shown = field.default if isinstance(field.default, tuple) else (field.default,)
    return f"(default: {' '.join(map(str, shown))})"


def _sentences(options: type) -> dict[str, str]:
    """What stands below each field of a class and of those that it is made of."""
    found: dict[str, str] = {}
    for each in reversed(options.__mro__):
        if not dataclasses.is_dataclass(each):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        assert isinstance(tree, ast.ClassDef)
        for field, below in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                name, text = ast.unparse(field.target), ast.literal_eval(below.value)
                found[name] = " ".join(text.split())
    return found


if __name__ == "__main__":
    PAGE.write_text(with_options(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
