"""The options of a command, read from its function: types from the signature, texts from the
docstring.

Positional-only parameters are arguments, the others options. The section "Parameters" must describe
each by a line `name : METAVAR (default: ...)`, where METAVAR and the parenthesis may be left out,
followed by indented lines with its help.
"""

import functools
import inspect
import re
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import tyro

# Values of an option that takes settings NAME=VALUE: one inner tuple each time that it is given.
Settings = tuple[tuple[str, ...], ...]
# Aliases by parameter, or by `command.parameter` for one command alone.
_ALIASES = {
    "out": ("-o",),
    "board": ("--pattern",),
    "lens": ("--intrinsics",),
    "undistort.rig": ("--lens", "--intrinsics"),
}
# Options that may be given several times, with one value each time: --board a --board b.
REPEATED = ("board", "lens")
# Options that all commands share, with their help: the fields of `Job`.
SHARED = {
    "json": "Print exactly one JSON object on stdout instead of text.",
    "quiet": "Show no progress on stderr.",
    "force": "Replace files of another kind.",
}
# Name, rest of the line, and help of a parameter.
_DESCRIPTION = re.compile(r"^ {4}(\w+)(?: : (.*))?\n((?: {8}.*\n)+)", re.MULTILINE)
_METAVAR_AND_DEFAULT = re.compile(r"(.*?) ?(\([^()]*\))?")


class Option(NamedTuple):
    """Option or argument of a command, and its description in the help.

    Attributes
    ----------
    name : str
        Name of the parameter.
    typed : str
        Flag as the user types it, such as "--from"; "" for an argument.
    kind : type
        Type of the parameter.
    default_text : str
        Default as the help shows it.
    text : str
        Help text.
    """

    name: str
    typed: str
    kind: Any
    default: Any
    metavar: str = ""
    default_text: str = ""
    text: str = ""
    aliases: tuple[str, ...] = ()

    @property
    def is_repeated(self) -> bool:
        """True if the option may be given several times."""
        is_tuple = typing.get_origin(self.kind) is tuple
        return is_tuple and (self.name in REPEATED or self.kind == Settings)

    def annotation(self) -> Any:
        """Type of the option, annotated for tyro with flag, metavar, help and aliases."""
        argument = tyro.conf.arg(
            name=self.typed[2:] or None,
            metavar=self.metavar or None,
            help=self.text,
            help_behavior_hint=self.default_text or None,
            aliases=self.aliases or None,
        )
        kind = Annotated[self.kind, argument]
        if not self.typed:
            return tyro.conf.Positional[kind]
        return tyro.conf.UseAppendAction[kind] if self.is_repeated else kind


@functools.cache
def list_options(command: Callable[..., Any]) -> tuple[Option, ...]:
    """Options of a command. The options that all commands have come last."""
    hints = typing.get_type_hints(command)
    described = {
        name: (slot, " ".join(text.split()))
        for name, slot, text in _DESCRIPTION.findall(command.__doc__ or "")
    }
    options = []
    for name, parameter in inspect.signature(command).parameters.items():
        if name == "job":
            continue
        slot, text = described[name]
        metavar, default_text = _METAVAR_AND_DEFAULT.fullmatch(slot).groups()  # pyright: ignore
        is_argument = parameter.kind is parameter.POSITIONAL_ONLY
        options.append(
            Option(
                name,
                "" if is_argument else f"--{name.rstrip('_').replace('_', '-')}",
                hints[name],
                parameter.default,
                metavar or _usual_metavar(hints[name]),
                default_text or _usual_default(parameter.default),
                text,
                _ALIASES.get(f"{command.__name__}.{name}", _ALIASES.get(name, ())),
            )
        )
    options += [Option(name, f"--{name}", bool, False, text=text) for name, text in SHARED.items()]
    return tuple(options)


def _usual_metavar(kind: Any) -> str:
    """Metavar of an option whose docstring gives none."""
    kinds = typing.get_args(kind) if type(None) in typing.get_args(kind) else (kind,)
    if Path in kinds or tuple[Path, ...] in kinds:
        return "FILE"
    if kind == Settings:
        return "NAME=VALUE..."
    choices = [
        each
        for literal in kinds
        if typing.get_origin(literal) is Literal
        for each in typing.get_args(literal)
    ]
    return "|".join(choices)


def _usual_default(default: Any) -> str:
    """Default as the help shows it; "" if tyro shows the default itself."""
    if default is inspect.Parameter.empty:
        return "(required)"
    if default is None:
        return "(default: none)"
    return "(optional)" if default == () else ""
