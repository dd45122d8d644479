"""JSON that nobody is trusted to have written: strict, and of bounded depth."""

import json
import os
import re
from typing import Any

from trinoc.errors import InputError

# Everything that trinoc reads is at most eight deep; Python's own parser fails at thousands.
MOST_NESTED = 64
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"?', re.DOTALL)


def parsed_json(text: str, file: str | os.PathLike[str]) -> Any:
    """The value of a JSON text; `file` is named in errors.

    Raises InputError for what is not JSON, NaN and infinities, keys given twice, numbers that are
    too long, texts that no file can hold, and nesting that is too deep.
    """
    _check_depth(text, file)
    try:
        values = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        if os.fspath(file).lower().endswith(".json"):
            place = f"line {error.lineno}, column {error.colno}: {error.msg}"
            raise InputError(f"{file} is not JSON ({place}): correct it there.") from error
        raise InputError(f"{file} is not JSON: give the .json file.") from error
    except _NotStrictError as error:
        raise InputError(f"{file}: {error}") from error
    except ValueError as error:  # of Python, whose integers have at most 4,300 digits
        raise InputError(
            f"{file} holds a number of thousands of digits: write it as 1.5e300, if it is meant."
        ) from error
    # Halves of a character, which JSON can name by \\u, cannot be printed or written again.
    if re.search(r"\\u[dD][89a-fA-F]", text) and _has_half_characters(values):
        raise InputError(f"{file} holds a \\u code that is no character: correct it.")
    return values


class _NotStrictError(Exception):
    """A text that Python would read although JSON does not allow it."""


def _check_depth(text: str, file: str | os.PathLike[str]) -> None:
    depth = 0
    for bracket in re.findall(r"[\[\]{}]", _QUOTED.sub("", text)):
        depth += 1 if bracket in "[{" else -1
        if depth > MOST_NESTED:
            raise InputError(
                f"{file} is nested more than {MOST_NESTED} deep, which no such file is: give "
                "another file."
            )


def _refuse_constant(name: str) -> float:
    raise _NotStrictError(f"{name} is no number that a file may hold: put a finite one there.")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise _NotStrictError(
            f"the key {json.dumps(twice)} stands twice in one object: keep one of them."
        )
    return values


def _has_half_characters(value: Any) -> bool:
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return True
    return False
