"""Frozen dataclasses of options in groups: one field changed by its dotted name."""

from dataclasses import fields, replace
from typing import Any, TypeVar

_Options = TypeVar("_Options")


def with_field(options: _Options, name: str, value: Any) -> _Options:
    """The same options with another value of one field, named by "group.field" or "field".

    Raises ValueError for a name that the options do not have.
    """
    group: Any = options
    first, _, rest = name.partition(".")
    own = [field.name for field in fields(group)]
    if first not in own:
        raise ValueError(f'There is no option "{first}": choose one of {", ".join(own)}.')
    changed = with_field(getattr(group, first), rest, value) if rest else value
    return replace(group, **{first: changed})
