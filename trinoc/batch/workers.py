"""Who does the work: threads of this process, or the workers of a Dask cluster."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

from trinoc.batch.work import Work, part_results
from trinoc.errors import InputError


class Workers(NamedTuple):
    """An executor, how many of its tasks run at once, and what it does with a part.

    where : for people. cluster : Dask's client, None for threads.
    """

    executor: Executor
    count: int
    do: Callable[[Any], Any]
    where: str
    cluster: Any = None


@contextlib.contextmanager
def threads(work: Work, count: int) -> Iterator[Workers]:
    """Threads of this process, which share its compiled kernels.

    When the block ends early, they give up between two pictures.
    """
    stop = threading.Event()
    executor = ThreadPoolExecutor(count, thread_name_prefix="trinoc-batch")
    try:
        yield Workers(executor, count, partial(part_results, work, stopped=stop.is_set), "threads")
    finally:
        stop.set()
        executor.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def cluster(work: Work, address: str) -> Iterator[Workers]:
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
        yield Workers(executor, count, partial(part_results, work), address, client)
    finally:
        client.close(timeout=5)  # what was submitted and not done is forgotten
