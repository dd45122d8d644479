"""What is typed, made into options: settings written NAME=VALUE, the names of before, and
trinoc.toml, which says what the commands of one rig are always told.

Each table of the file is a command, each key one of its options, `images` the files of its cameras:

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
import re
import tomllib
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from trinoc.cli.command import UsageError

OLD_COMMANDS = {
    "doctor": "trinoc --version",
    "import": "trinoc export FILE --from FORMAT -o OUT",
    "wireframe": "trinoc match ... --steps wireframe",
}

_OLD_FIND = {
    "tolerance-px": "--find tolerance_px=PX",
    "false-alarms": "--find false_alarms=NUMBER",
    "least-contrast": "--find least_contrast=LEVELS",
    "arcs": "--find arcs=yes",
    "response": "--find response=srgb",
}
_OLD_SIGMA = {
    "print-scale-sigma": "--sigma print_scale=X,Y",
    "flatness-mm": "--sigma flatness_mm=MM",
}
_OLD_LENS = "--lens-mm FOCAL WIDTH HEIGHT"
OLD_OPTIONS: dict[str, dict[str, str]] = {
    "pattern": {
        "board": "trinoc pattern KIND",
        "square-mm": "trinoc pattern KIND square_mm=MM",
        "marker-mm": "trinoc pattern charuco marker_mm=MM",
        "tag-mm": "trinoc pattern aprilgrid tag_mm=MM",
        "tag-spacing": "trinoc pattern aprilgrid spacing=RATIO",
        "dictionary": "trinoc pattern KIND dictionary=NAME",
        "first": "trinoc pattern KIND first=N",
        "pitch-mm": "trinoc pattern sheet pitch_mm=MM",
        "radius-mm": "trinoc pattern sheet radius_mm=MM",
        "line-style": "trinoc pattern sheet line_style=stop|through|white",
        "for-distance-mm": "--camera distance_mm=MM field_deg=DEG size_px=W,H",
        "field-deg": "--camera distance_mm=MM field_deg=DEG size_px=W,H",
        "image-size-px": "--camera distance_mm=MM field_deg=DEG size_px=W,H",
        "screen-px": "--screen size_px=W,H diagonal_inch=INCH",
        "screen-inch": "--screen size_px=W,H diagonal_inch=INCH",
        "screen-pitch-mm": "--screen size_px=W,H pitch_mm=MM",
    },
    "watch": {"no-page": "--port none", "open": "--port open"},
    "view": {"open": "--port open"},
    "intrinsics": {
        "principal-point": "--hold principal-point, or nothing where it is free",
        "aspect": "--hold aspect, or nothing where it is free",
    },
    "calibrate": {
        "focal-length-mm": _OLD_LENS,
        "pixel-pitch-mm": _OLD_LENS,
        "lens-exact": "--sigma lens=0",
        "no-lens-covariance": "--sigma lens=0",
        **_OLD_SIGMA,
        "aim-sigma-mm": "--sigma aim_mm=MM",
        "parameters": "--pose-model aimed (of 4) or aim-free (of 6)",
    },
    "calibrate-rig": _OLD_SIGMA,
    "match": {
        **_OLD_FIND,
        "guided": "--steps guided",
        "measure": "--steps pixels",
        "cylinders": "--steps cylinders",
        "rims": "--steps rims",
        "rims-out": "--steps rims, which are written beside the matches",
        "shadows": "--steps shadows",
    },
    "batch": {**_OLD_FIND, "threads": "--workers N", "scheduler": "--workers tcp://HOST:PORT"},
    "refine": {"intrinsics": "--free-lens"},
    "export": {"lenses": "--lens FILE"},
}
OLD_KEYS = {"pictures": "images"}


def refuse_old_names(arguments: Sequence[str]) -> None:
    """Raise UsageError, which says the new spelling, for a command or option of before."""
    if not arguments:
        return
    command = arguments[0]
    if command in OLD_COMMANDS:
        raise UsageError(f"{command} is now: {OLD_COMMANDS[command]}")
    for word in arguments[1:]:
        given = re.match(r"--([\w-]+)", word)
        old = given[1].replace("_", "-") if given else ""
        if old in OLD_OPTIONS.get(command, {}):
            raise UsageError(f"--{old} of trinoc {command} is now: {OLD_OPTIONS[command][old]}")


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


SETTINGS_FILE = Path("trinoc.toml")
POSITIONAL = "images"
# Of each group one counts: what is typed.
ONE_OF = (
    ("--out", "-o"),
    ("--board", "--pattern"),
    ("--rig", "--lens", "--intrinsics", "--lens-mm"),
    ("--to", "--from"),
)
# These take one value each time they are given.
REPEATED = ("--board", "--pattern", "--lens", "--intrinsics")


def with_file(arguments: Sequence[str], file: Path = SETTINGS_FILE) -> list[str]:
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
        if key in OLD_KEYS:
            raise UsageError(f"{file}: {key} is now: {OLD_KEYS[key]}")
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
