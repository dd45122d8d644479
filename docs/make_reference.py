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
        listed = "".join(f"- {line}\n" for line in _listed(name, options, first))
        section = rf"(### `trinoc {name}`\n(?:(?!### |- `).*\n)*?)(?:- `.*\n)+"
        page, count = re.subn(section, lambda match, lines=listed: match[1] + lines, page)
        assert count == 1, f"{PAGE.name} has no list of options of {name}"
    return page


def _listed(
    command: str, options: list[tuple[str, str]], first: dict[tuple[str, str], str]
) -> list[str]:
    """A line for each option. Options equal to an earlier command's share one line at the end."""
    lines, shared = [], {}
    for option, text in options:
        owner = first.setdefault((option, text), command)
        if owner == command:
            lines.append(f"{option}: {text}")
        else:
            shared.setdefault(owner, []).append(option)
    return lines + [
        f"{', '.join(names)}: as of `trinoc {owner}`" for owner, names in shared.items()
    ]


def _options(command: str) -> list[tuple[str, str]]:
    """(typed form, description) of each option."""
    rows = [
        (_typed(option), " ".join(filter(None, (option.text, _default(option)))))
        for option in list_options(find_command(command))
        if option.name not in SHARED
    ]
    return sorted(rows, key=lambda row: row[0].startswith("`-"))


def _typed(option: Option) -> str:
    """The option's main form with its value, and its other names."""
    if not option.typed:
        return f"`{option.metavar}`"
    main_form = f"{option.typed} {option.metavar}".strip()
    names = sorted(
        (*option.aliases, main_form), key=lambda name: (name.startswith("--"), name != main_form)
    )
    return ", ".join(f"`{name}`" for name in names)


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
