"""That something compiles, told to whoever waits for it.

Logging stands on a floor above. The package's front door says who tells (`set_compile_notice`).
"""

import contextlib
import time
from collections.abc import Callable, Iterator

# Called with whether the program is kept for later processes, and the seconds of compiling so far.
Notice = Callable[[bool, float], None]

# numerical: seconds of compiling after which it is told again.
_AGAIN_S = 30.0
_notices: list[Notice] = []
# Of this process: seconds of compiling so far, and those at which it is told next.
_seconds, _next_at = [0.0], [0.0]


def set_compile_notice(notice: Notice) -> None:
    """Call `notice` before something compiles: at first, and then each half minute of it."""
    _notices[:] = [notice]


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """A block that compiles a program which is kept for later processes."""
    notice_compiling(is_kept=True)
    begin = time.monotonic()
    try:
        yield
    finally:
        _seconds[0] += time.monotonic() - begin


def notice_compiling(*, is_kept: bool) -> None:
    """Tell that something is about to compile, unless that has just been told."""
    if _seconds[0] >= _next_at[0]:
        _next_at[0] = _seconds[0] + _AGAIN_S
        for notice in _notices:
            notice(is_kept, _seconds[0])
