"""The lists of options of reference.md, as commands declare them: docs/make_reference.py"""

import re
from pathlib import Path

from trinoc.cli.main import find_command
from trinoc.cli.options import SHARED, Option, list_options

PAGE = Path(__file__).parent / "reference.md"


def with_options(page: str) -> str:
    """The page with the options of every command as its function declares them."""
    first: dict[tuple[str, str], str] = {}
    for name in re.findall(r"^### `trinoc ([\w-]+)`", page, re.M):
        options = _options(name)
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


def _options(command: str) -> list[tuple[str, str]]:
    """(how it is typed, what it says) of each option."""
    rows = [
        (_typed(option), " ".join(filter(None, (option.text, _default(option)))))
        for option in list_options(find_command(command))
        if option.name not in SHARED
    ]
    return sorted(rows, key=lambda row: row[0].startswith("`-"))


def _typed(option: Option) -> str:
    """The option with its short form, what is typed behind it, and its other names."""
    if not option.typed:
        return f"`{option.metavar}`"
    whole = f"{option.typed} {option.metavar}".strip()
    names = sorted(
        (*option.aliases, whole), key=lambda each: (each.startswith("--"), each != whole)
    )
    return ", ".join(f"`{each}`" for each in names)


def _default(option: Option) -> str:
    if option.default_text:
        return (
            "" if option.default_text in ("(default: none)", "(optional)") else option.default_text
        )
    if option.default is False:
        return ""
    shown = option.default if isinstance(option.default, tuple) else (option.default,)
    return f"(default: {' '.join(map(str, shown))})"


if __name__ == "__main__":
    PAGE.write_text(with_options(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
