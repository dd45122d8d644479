"""Workers: threads, processes or a Dask cluster, with a bounded number of open tasks."""

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
    """Workers that match the parts of a recording.

    Attributes
    ----------
    executor : Executor
        Executor that runs the tasks.
    count : int
        Number of parallel tasks.
    do : callable
        Function that a task applies to a part.
    where : str
        Name of the workers in messages.
    """

    executor: Executor
    count: int
    do: Callable[[Any], Any]
    where: str


@contextlib.contextmanager
def threads(work: MatchingJob, count: int) -> Iterator[Workers]:
    """Context manager that yields threads of this process, which share its compiled kernels.

    If the block ends early, the threads stop between two frames.
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
    """Context manager that yields worker processes.

    They are faster than threads, because threads of one process run small Python steps one at a
    time. The processes read the compiled kernels of this process, and stop as threads do. They
    import the main script, which therefore needs `if __name__ == "__main__":`.
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
    """Context manager in which started processes ignore Ctrl-C, so that only this process receives
    it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# In a worker process: its function.
_task_function: list[Callable[[Any], Any]] = []


def _begin(work: MatchingJob, stop: Any, cached: bool) -> None:
    import cv2

    from trinoc.io.compile_cache import enable_compile_cache

    # Each process has its own core; the parent process reports the progress.
    cv2.setNumThreads(1)
    logging.getLogger("trinoc").setLevel(logging.WARNING)
    if cached:
        enable_compile_cache()
    _task_function.append(partial(part_results, work, stopped=stop.is_set))


def _results_in_process(part: Any) -> Any:
    return _task_function[0](part)


@contextlib.contextmanager
def cluster(work: MatchingJob, address: str) -> Iterator[Workers]:
    """Context manager that yields the workers of a Dask cluster.

    The workers must have the images under the same paths. Raises InputError if Dask is not
    installed, the scheduler does not answer, or it has no workers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "A scheduler needs Dask. Run pip install 'trinoc[batch]', or omit the scheduler."
        ) from error
    try:
        client: Any = Client(address, timeout="20s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"No Dask scheduler answers at {address} ({error}). Start it, or correct the address."
        ) from error
    try:
        count = sum(client.nthreads().values())
        if not count:
            raise InputError(f"The Dask scheduler at {address} has no workers. Start some first.")
        executor = client.get_executor(pure=False)
        yield Workers(executor, count, partial(part_results, work), address)
    finally:
        client.close(timeout=5)  # what was submitted and not done is forgotten


def in_window(
    executor: Executor,
    work: Callable[[_Task], Any],
    tasks: Iterable[_Task],
    window: int,
    may_start: Callable[[], bool] = lambda: True,
) -> Iterator[tuple[_Task, Future[Any]]]:
    """Run tasks and yield each task with its finished future, in the order of completion.

    window : largest number of tasks that are started and not yet yielded. The limit keeps results
        from accumulating in memory if the consumer is slow.
    may_start : function that permits a further task. While it returns False, tasks run one at a
        time.
    """
    open_tasks: dict[Future[Any], _Task] = {}
    remaining = iter(tasks)
    while True:
        while len(open_tasks) < window and (not open_tasks or may_start()):
            if (task := next(remaining, None)) is None:
                break
            open_tasks[executor.submit(work, task)] = task
        if not open_tasks:
            return
        done, _ = wait(open_tasks, return_when=FIRST_COMPLETED)
        future = next(iter(done))
        yield open_tasks.pop(future), future
