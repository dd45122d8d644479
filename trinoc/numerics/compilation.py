"""A program that several threads want at once is compiled by one of them."""

import contextlib
import threading
from collections.abc import Hashable, Iterator

_compiling = threading.Lock()
_compiled: set[Hashable] = set()


@contextlib.contextmanager
def one_compiles(*program: Hashable) -> Iterator[None]:
    """Hold a block that calls a jitted program until another thread has compiled the same.

    Threads that meet an uncompiled program would each compile it, in time and memory of their own.

    program : all that tells it from others: its name, static arguments and shapes.
    """
    if program in _compiled:
        yield
        return
    with _compiling:
        yield
        _compiled.add(program)
