"""Annotated shapes and dtypes, checked on the first calls of each function in each file of tests.

What is called ten thousand times by a test that draws noise has been checked by then, and each
check takes longer than many a function. Code of a check is made when it is first asked for.
"""

import contextlib
import functools
import inspect
import sys
from collections.abc import Callable
from typing import Any, ClassVar

import jaxtyping
from beartype import BeartypeConf, beartype

# Calls of a function that are checked in one file.
MOST_CALLS = 8
# The numeric tower lets 16 stand where a float is annotated, as every type checker does.
_CONF = BeartypeConf(is_pep484_tower=True)


class _File:
    """The number of the current test file, and the functions that it no longer checks."""

    number = 0
    past: ClassVar[list[Any]] = []


def begin_file() -> None:
    """Start a new test file, in which all functions are checked again."""
    _File.number += 1
    for function in _File.past:
        function.__no_type_check__ = False
    _File.past.clear()


def check_first_calls(signature: Callable[..., Any]) -> Callable[..., Any]:
    """A checker of calls with that signature, as jaxtyping's import hook makes one for a function
    without its result and one with it; both end the checks of the function after MOST_CALLS."""
    checked: Callable[..., Any] | None = None
    file, remaining = -1, 0

    def check(*arguments: Any, **named: Any) -> Any:
        nonlocal checked, file, remaining
        if checked is None:
            checked = beartype(conf=_CONF)(signature)
        if file != _File.number:
            file, remaining = _File.number, MOST_CALLS
        remaining -= 1
        if remaining == 0:
            # jaxtyping, which calls, holds the function itself, and asks it for this word.
            function = sys._getframe(1).f_locals.get("fn")
            with contextlib.suppress(AttributeError):
                function.__no_type_check__ = True  # pyright: ignore[reportOptionalMemberAccess]
                _File.past.append(function)
        return checked(*arguments, **named)

    return check


def _decorate_late(
    function: Callable[..., Any], decorate: Callable[..., Any]
) -> Callable[..., Any]:
    """The function, decorated when it is first called: a file of tests calls few of all."""

    @functools.cache
    def decorated() -> Callable[..., Any]:
        return decorate(function)

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        return decorated()(*arguments, **named)

    return call


def install() -> None:
    """Check the annotations of all modules of trinoc and simulation that are imported later.

    The hook decorates by `jaxtyping.jaxtyped`. A function within a function is made anew at each
    call of that, and making a check takes longer than most of them: they are left out.
    """
    decorator = jaxtyping.jaxtyped

    def decorate_outer(*, typechecker: Callable[..., Any]) -> Callable[..., Any]:
        decorate = decorator(typechecker=typechecker)

        def choose(each: Any) -> Any:
            if "<locals>" in getattr(each, "__qualname__", ""):
                return each
            return _decorate_late(each, decorate) if inspect.isfunction(each) else decorate(each)

        return choose

    jaxtyping.jaxtyped = decorate_outer
    jaxtyping.install_import_hook(["trinoc", "simulation"], "tests.first_calls.check_first_calls")
