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
    """Set the function that is called when a program is compiled.

    It is called before the first compilation, and then after every 30 s of compiling.

    Parameters
    ----------
    notice : callable
        Function of a bool and a float. True: the program is stored for later processes. Seconds of
        compiling in this process so far.
    """
    _notices[:] = [notice]


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Context for the compilation of a program that is stored for later processes.

    It calls the notice function and measures the time.
    """
    notice_compiling(is_kept=True)
    begin = time.monotonic()
    try:
        yield
    finally:
        _seconds[0] += time.monotonic() - begin


def notice_compiling(*, is_kept: bool) -> None:
    """Call the notice function, unless less than 30 s of compiling have passed since its last call.

    Parameters
    ----------
    is_kept : bool
        True if the program is stored for later processes.
    """
    if _seconds[0] >= _next_at[0]:
        _next_at[0] = _seconds[0] + _AGAIN_S
        for notice in _notices:
            notice(is_kept, _seconds[0])
