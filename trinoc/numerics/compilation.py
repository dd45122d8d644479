"""Compiling with threads: of several programs at the same time, and of one only once."""

import contextlib
import threading
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax

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


def at_once(*works: Callable[[], object]) -> None:
    """Run functions at the same time, in threads with the caller's precision; the first error is
    raised when all are done.

    For what compiles: XLA does it outside Python's lock, on a core of its own.
    """
    config: Any = jax.config
    precision = config.jax_enable_x64

    def run(work: Callable[[], object]) -> None:
        # The setting belongs to the thread.
        with jax.enable_x64(precision):
            work()

    with ThreadPoolExecutor(len(works)) as threads:
        for done in [threads.submit(run, work) for work in works]:
            done.result()
