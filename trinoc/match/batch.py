"""Many rigs, or many frames of one, matched in one call that no single failure ends."""

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
from jaxtyping import Shaped

from trinoc.errors import TrinocError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.decoys import Verification
from trinoc.match.matcher import (
    check_before_cameras,
    check_together,
    check_verification,
    match_frames,
)
from trinoc.match.observations.match_input import (
    CamerasInput,
    FrameInput,
    prepare_cameras,
    prepare_frame,
)
from trinoc.match.selection.messages import FRAMES_AT_ONCE
from trinoc.match.tracks.matches import Matches, MatchStatus
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.buckets import bucket
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.programs import one_compiles
from trinoc.numerics.values import Value

OK = "ok"
# numerical: frames with more segments in a view than this, or of more views, fill a problem
# alone; a stack holds as many segments of a view as this at most.
LARGEST_FRAME, LARGEST_STACK, MOST_VIEWS = 1 << 8, 1 << 13, 3
# numerical: more threads than these would wait for the interpreter.
MOST_THREADS = 4


class MatchBatch(Value):
    """Matches of each item, None where there are none; `status` (n,) is "ok" or says why."""

    matches: tuple[Matches | None, ...]
    status: Shaped[np.ndarray, "n"]

    def __len__(self) -> int:
        return len(self.matches)


@in_float64
def match_many(
    segments: Sequence[Mapping[str, Segments | ArrayLike]],
    rigs: Rig | Iterable[Rig],
    *,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] | None = None,
    verify: Verification = "full",
    tuning: MatchTuning = DEFAULT,
) -> MatchBatch:
    """`match_segments` for each item: segments of one frame, with a rig each or one for all.

    An item that cannot be matched has its sentence for a status, and the others their
    matches. Small frames are stacked and matched as one problem, up to 64 at a time, which gives
    what each gives alone: every frame learns its own parameters. Stacks are matched on as many
    threads as there are processors, up to four.

    `verify` is as in `match_segments`. Of each rig the mistake is looked for in the first set that
    is refused, and the others of that rig are checked quickly.

    Raises ValueError where there are not as many rigs as items.
    """
    check_verification(verify)
    each = [rigs] * len(segments) if isinstance(rigs, Rig) else list(rigs)
    items = list(zip(segments, each, strict=True))
    found: list[Matches | None] = [None] * len(items)
    status = [OK] * len(items)
    frames: dict[int, FrameInput] = {}

    def prepare_all() -> Iterator[tuple[int, FrameInput]]:
        checked: dict[tuple[int, tuple[str, ...]], CamerasInput] = {}
        for number, (item, rig) in enumerate(items):
            try:
                frames[number] = _prepare_item(item, rig, sigma_px, tuning, checked)
            except TrinocError as error:
                status[number] = str(error)
            else:
                yield number, frames[number]

    def match_stack(stack: list[int]) -> list[Matches]:
        names = [tuple(items[number][0]) for number in stack]
        return match_frames([frames[k] for k in stack], names, depth_range_mm, tuning)

    refused_rigs = set[int]()
    for stack, results in _each_matched(_stacks(prepare_all()), frames, match_stack):
        for number, matches in zip(stack, results, strict=True):
            item, rig = items[number]
            try:
                check_before_cameras(
                    frames[number], matches, item, rig, sigma_px, depth_range_mm, tuning
                )
            except TrinocError as error:
                status[number] = str(error)
            else:
                how = "quick" if verify == "full" and id(rig) in refused_rigs else verify
                checked = check_together(
                    frames[number], tuple(item), matches, depth_range_mm, tuning, how
                )
                found[number] = checked
                if checked.status is MatchStatus.SUSPECT:
                    refused_rigs.add(id(rig))
    return MatchBatch(tuple(found), np.array(status, dtype=np.str_))


def _each_matched(
    stacks: Iterable[list[int]],
    frames: Mapping[int, FrameInput],
    matched: Callable[[list[int]], list[Matches]],
) -> list[tuple[list[int], list[Matches]]]:
    """Stacks and their matches: small frames on threads, while others are prepared.

    Large ones, whose programs have threads of their own and which take much memory, come after.
    """
    config: Any = jax.config
    device, large = config.jax_default_device, []

    def on_thread(stack: list[int]) -> list[Matches]:
        numbers = [[len(ends) for ends in frames[k].ends_px] for k in stack]
        sizes = bucket(max(map(sum, zip(*numbers, strict=True)))), bucket(len(stack))
        # Settings of JAX are each thread's own.
        with jax.default_device(device), one_compiles("match_frames", len(numbers[0]), *sizes):
            return in_float64(matched)(stack)

    with ThreadPoolExecutor(min(multiprocessing.cpu_count(), MOST_THREADS)) as threads:
        waiting = []
        for stack in stacks:
            if _is_small(frames[stack[0]]):
                waiting.append((stack, threads.submit(on_thread, stack)))
            else:
                large.append(stack)
        done = [(stack, results.result()) for stack, results in waiting]
    return done + [(stack, matched(stack)) for stack in large]


def _prepare_item(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    sigma_px: float | None,
    tuning: MatchTuning,
    checked: dict[tuple[int, tuple[str, ...]], CamerasInput],
) -> FrameInput:
    """A frame; the cameras of a rig that many frames share are checked once."""
    key = id(rig), tuple(segments)
    if key not in checked and len(segments) > 1 and set(segments) <= set(rig.names):
        checked[key] = prepare_cameras(rig, segments)
    return prepare_frame(segments, rig, sigma_px, tuning.sides, checked.get(key))


def _size(frame: FrameInput) -> tuple[int, int]:
    """(number of views, segments in the fullest of them)."""
    return len(frame.names), max(len(ends) for ends in frame.ends_px)


def _is_small(frame: FrameInput) -> bool:
    views, size = _size(frame)
    return views <= MOST_VIEWS and size <= LARGEST_FRAME


def _stacks(frames: Iterable[tuple[int, FrameInput]]) -> Iterator[list[int]]:
    """Numbers of the frames that are matched together."""
    waiting: dict[int, list[int]] = {}
    filled: dict[int, int] = {}
    for number, frame in frames:
        if not _is_small(frame):
            yield [number]
            continue
        views, size = _size(frame)
        stack = waiting.setdefault(views, [])
        if len(stack) == FRAMES_AT_ONCE or filled.get(views, 0) + size > LARGEST_STACK:
            yield stack
            stack = waiting[views] = []
            filled[views] = 0
        stack.append(number)
        filled[views] = filled.get(views, 0) + size
    yield from (stack for stack in waiting.values() if stack)
