"""The window of tasks in the air, and the memory that bounds it."""

from concurrent.futures import Executor, Future, ThreadPoolExecutor

import pytest
from hypothesis import given, strategies as st

from trinoc.batch.run import (
    BASE_BYTES,
    BYTES_PER_PIXEL,
    affordable_processes,
    affordable_threads,
    half_of_memory,
    resident_bytes,
)
from trinoc.batch.workers import in_window
from trinoc.synth import table1_rig


class AtOnce(Executor):
    """Executor that runs every task when it is submitted and counts the submissions."""

    def __init__(self):
        self.submitted = 0

    def submit(self, fn, /, *args, **kwargs):
        self.submitted += 1
        future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@given(count=st.integers(0, 30), window_size=st.integers(1, 8), full=st.sets(st.integers(0, 30)))
def test_each_task_once_and_never_more_than_the_window(count, window_size, full):
    executor, taken = AtOnce(), []

    def room():
        return len(taken) not in full

    for task, future in in_window(executor, lambda k: -k, range(count), window_size, room):
        assert future.result() == -task
        taken.append(task)
        assert executor.submitted - len(taken) <= window_size - 1
    assert sorted(taken) == list(range(count))


def test_where_there_is_no_room_tasks_go_one_by_one():
    executor, taken = AtOnce(), 0
    for _ in in_window(executor, lambda k: k, range(10), 4, lambda: False):
        taken += 1
        assert executor.submitted == taken
    assert taken == 10


def test_a_task_that_fails_hands_on_its_error_and_the_others_go_on():
    def work(k):
        if k == 2:
            raise ValueError("two")
        return k

    with ThreadPoolExecutor(2) as executor:
        ended = dict(in_window(executor, work, range(5), 3))
    assert {k: future.result() for k, future in ended.items() if k != 2} == {
        k: k for k in (0, 1, 3, 4)
    }
    with pytest.raises(ValueError, match="two"):
        ended[2].result()


@pytest.mark.parametrize(
    ("affordable", "own_bytes"), [(affordable_threads, 0), (affordable_processes, BASE_BYTES)]
)
@given(wanted=st.integers(1, 64), gigabytes=st.floats(0, 1000))
def test_workers_fit_into_the_memory_and_no_more_would_or_are_one(
    affordable, own_bytes, wanted, gigabytes
):
    rig = table1_rig()
    width, height = rig["upper"].image_size_px
    worker_count = affordable(gigabytes * 1e9, rig, wanted)
    assert 1 <= worker_count <= wanted
    worker_bytes = own_bytes + BYTES_PER_PIXEL * width * height
    assert worker_count == 1 or BASE_BYTES + worker_count * worker_bytes <= gigabytes * 1e9
    assert (
        worker_count == wanted or BASE_BYTES + (worker_count + 1) * worker_bytes > gigabytes * 1e9
    )


def test_this_process_takes_some_of_the_machine_s_memory():
    assert 0 <= resident_bytes() < half_of_memory() * 2
