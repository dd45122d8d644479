"""Who does the work, threads of this process, processes of their own or the workers of a Dask
cluster, and how many tasks are in the air."""

import contextlib
import logging
import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from functools import partial
from typing import Any, NamedTuple, TypeVar

from trinoc.batch.work import MatchingJob, part_results
from trinoc.errors import InputError

_Task = TypeVar("_Task")


class Workers(NamedTuple):
    """An executor, how many of its tasks run at once, and what it does with a part.

    where : for people.
    """

    executor: Executor
    count: int
    do: Callable[[Any], Any]
    where: str


@contextlib.contextmanager
def threads(work: MatchingJob, count: int) -> Iterator[Workers]:
    """Threads of this process, which share its compiled kernels.

    When the block ends early, they give up between two frames.
    """
    stop = threading.Event()
    executor = ThreadPoolExecutor(count, thread_name_prefix="trinoc-batch")
    try:
        yield Workers(executor, count, partial(part_results, work, stopped=stop.is_set), "threads")
    finally:
        stop.set()
        executor.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def processes(work: MatchingJob, count: int) -> Iterator[Workers]:
    """Processes of their own: Python lets one thread of a process at a time do the small steps of
    finding and matching, so that a second thread gains next to nothing.

    They read this process's compiled kernels, and give up as threads do. A script that calls this
    needs `if __name__ == "__main__":`, because they import it.
    """
    import jax

    config: Any = jax.config
    spawn = multiprocessing.get_context("spawn")
    stop = spawn.Event()
    executor = ProcessPoolExecutor(
        count, spawn, _begin, (work, stop, config.jax_compilation_cache_dir is not None)
    )
    try:
        with _no_interruption():
            for _ in range(count):
                executor.submit(int)
        yield Workers(executor, count, _results_in_process, "processes")
    finally:
        stop.set()
        executor.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _no_interruption() -> Iterator[None]:
    """What is begun in the block leaves Ctrl-C to this process, from its first moment on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# Of a process that works for another: what it is to do.
_begun: list[Callable[[Any], Any]] = []


def _begin(work: MatchingJob, stop: Any, cached: bool) -> None:
    import cv2

    from trinoc.io.compile_cache import enable_compile_cache

    # Each has a core of its own, and the process that asked tells how far all are.
    cv2.setNumThreads(1)
    logging.getLogger("trinoc").setLevel(logging.WARNING)
    if cached:
        enable_compile_cache()
    _begun.append(partial(part_results, work, stopped=stop.is_set))


def _results_in_process(part: Any) -> Any:
    return _begun[0](part)


@contextlib.contextmanager
def cluster(work: MatchingJob, address: str) -> Iterator[Workers]:
    """The workers of a Dask cluster, which must see the pictures under the same paths.

    Raises InputError where Dask is not installed, nobody answers, or there is no worker.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "A scheduler needs Dask: pip install 'trinoc[batch]', or leave the scheduler out."
        ) from error
    try:
        client: Any = Client(address, timeout="20s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"No Dask scheduler answers at {address} ({error}): start it, or correct the address."
        ) from error
    try:
        count = sum(client.nthreads().values())
        if not count:
            raise InputError(f"The Dask scheduler at {address} has no worker: start some first.")
        executor = client.get_executor(pure=False)
        yield Workers(executor, count, partial(part_results, work), address)
    finally:
        client.close(timeout=5)  # what was submitted and not done is forgotten


def in_window(
    executor: Executor,
    work: Callable[[_Task], Any],
    tasks: Iterable[_Task],
    most: int,
    may_start: Callable[[], bool] = lambda: True,
) -> Iterator[tuple[_Task, Future[Any]]]:
    """(task, its finished future) of every task, in the order in which they end.

    At most `most` are begun and not yet handed on, so that results do not pile up where whoever
    takes them is slow. While `may_start` says no, none is begun but one at a time.
    """
    flying: dict[Future[Any], _Task] = {}
    coming = iter(tasks)
    while True:
        while len(flying) < most and (not flying or may_start()):
            if (task := next(coming, None)) is None:
                break
            flying[executor.submit(work, task)] = task
        if not flying:
            return
        done, _ = wait(flying, return_when=FIRST_COMPLETED)
        future = next(iter(done))
        yield flying.pop(future), future
