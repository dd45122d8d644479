"""Numbers on the command line, checked before any work starts."""

import dataclasses
import math
from collections.abc import Iterator

from trinoc.cli.command import UsageError


def expect_numbers(options: object) -> None:
    """Raise UsageError for an option that is not a number, or infinite where nothing is meant.

    Infinite numbers are taken where the option has one by default.
    """
    for name, value, default in _given(options):
        numbers = value if isinstance(value, tuple) else (value,)
        usual = default if isinstance(default, tuple) else (default,)
        for number in numbers:
            if not isinstance(number, float) or math.isfinite(number) or number in usual:
                continue
            raise UsageError(f"--{name.replace('_', '-')} is {number}: give a finite number.")


def expect_sigmas(option: str, sigmas: tuple[float, ...]) -> None:
    """Raise UsageError for a standard deviation below zero."""
    if min(sigmas) < 0:
        said = " ".join(f"{sigma:g}" for sigma in sigmas)
        raise UsageError(f"{option} {said} is no standard deviation: give 0 or more.")


def _given(options: object) -> Iterator[tuple[str, object, object]]:
    """(name, value, default) of every option, those of groups of options, too."""
    for field in dataclasses.fields(options):  # pyright: ignore[reportArgumentType]
        value = getattr(options, field.name)
        if dataclasses.is_dataclass(value):
            yield from _given(value)
        else:
            yield field.name, value, field.default
