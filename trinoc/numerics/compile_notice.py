"""Notice to the user that a program compiles.

Logging belongs to a higher floor: the package's front door sets the callback
(`set_compile_notice`).
"""

import contextlib
import time
from collections.abc import Callable, Iterator

# Arguments: True if the program is kept for later processes; seconds of compiling so far.
Notice = Callable[[bool, float], None]

# numerical: seconds of compiling between two notices.
_AGAIN_S = 30.0
_notices: list[Notice] = []
# Seconds of compiling in this process, and the number at which the next notice is due.
_seconds, _next_at = [0.0], [0.0]


def set_compile_notice(notice: Notice) -> None:
    """Set the function that is called when a program compiles.

    It is called before the first program, then after every 30 s of compiling.
    """
    _notices[:] = [notice]


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Context in which a program compiles that the store keeps for later processes."""
    notice_compiling(is_kept=True)
    begin = time.monotonic()
    try:
        yield
    finally:
        _seconds[0] += time.monotonic() - begin


def notice_compiling(*, is_kept: bool) -> None:
    """Call the notices, unless they were called within the last 30 s of compiling."""
    if _seconds[0] >= _next_at[0]:
        _next_at[0] = _seconds[0] + _AGAIN_S
        for notice in _notices:
            notice(is_kept, _seconds[0])
