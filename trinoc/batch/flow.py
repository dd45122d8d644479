"""So many tasks in the air and no more."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any, TypeVar

_Task = TypeVar("_Task")


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
            try:
                task = next(coming)
            except StopIteration:
                break
            flying[executor.submit(work, task)] = task
        if not flying:
            return
        done, _ = wait(flying, return_when=FIRST_COMPLETED)
        future = next(iter(done))
        yield flying.pop(future), future
