"""Match many rigs, or many frames of one rig, in one call; an error affects only its own frame."""

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
    check_rig_consistency,
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
from trinoc.numerics.programs import compile_once
from trinoc.numerics.values import Value

OK = "ok"
# numerical: a frame with more segments in a view than LARGEST_FRAME, or with more views than
# MAX_VIEWS, is matched alone. LARGEST_STACK limits the segments of a view in a stack.
LARGEST_FRAME, LARGEST_STACK, MAX_VIEWS = 1 << 8, 1 << 13, 3
# numerical: more threads would wait for the interpreter.
MAX_THREADS = 4


class MatchBatch(Value):
    """Result of `match_many` for n frames.

    Attributes
    ----------
    matches : tuple of Matches or None
        Matches of each frame; None if the frame could not be matched.
    status : (n,)
        "ok", or the error message of a frame that could not be matched.
    """

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
    """Match the segments of many frames, each as `match_segments` does.

    Parameters
    ----------
    segments : sequence of mappings
        For each frame, a mapping from camera names to segments, as in `match_segments`.
    rigs : Rig or iterable of Rig
        One rig for all frames, or one rig for each frame.
    sigma_px : float, optional
        As in `match_segments`.
    depth_range_mm : (float, float), optional
        As in `match_segments`.
    verify : "full", "quick" or "off"
        As in `match_segments`. After the first SUSPECT frame of a rig, "full" tests later frames of
        that rig as "quick" does.
    tuning : MatchTuning
        As in `match_segments`.

    Returns
    -------
    MatchBatch
        Matches of each frame, or the error message of a frame that cannot be matched.

    Raises
    ------
    ValueError
        If the number of rigs differs from the number of frames.

    Notes
    -----
    Up to 64 small frames are stacked and matched as one problem. The result is the same as for each
    frame alone, because every frame has its own parameters. Stacks run on one thread per processor,
    at most four.
    """
    check_verification(verify)
    rig_of_item = [rigs] * len(segments) if isinstance(rigs, Rig) else list(rigs)
    items = list(zip(segments, rig_of_item, strict=True))
    item_matches: list[Matches | None] = [None] * len(items)
    status = [OK] * len(items)
    frames: dict[int, FrameInput] = {}

    def prepare_all() -> Iterator[tuple[int, FrameInput]]:
        camera_cache: dict[tuple[int, tuple[str, ...]], CamerasInput] = {}
        for k, (item, rig) in enumerate(items):
            try:
                frames[k] = _prepare_item(item, rig, sigma_px, tuning, camera_cache)
            except TrinocError as error:
                status[k] = str(error)
            else:
                yield k, frames[k]

    def match_stack(stack: list[int]) -> list[Matches]:
        names = [tuple(items[k][0]) for k in stack]
        return match_frames([frames[k] for k in stack], names, depth_range_mm, tuning)

    refused_rigs = set[int]()
    for stack, results in _match_stacks(_group_frames(prepare_all()), frames, match_stack):
        for k, matches in zip(stack, results, strict=True):
            item, rig = items[k]
            try:
                check_before_cameras(
                    frames[k], matches, item, rig, sigma_px, depth_range_mm, tuning
                )
            except TrinocError as error:
                status[k] = str(error)
            else:
                verification = "quick" if verify == "full" and id(rig) in refused_rigs else verify
                verified = check_rig_consistency(
                    frames[k], tuple(item), matches, depth_range_mm, tuning, verification
                )
                item_matches[k] = verified
                if verified.status is MatchStatus.SUSPECT:
                    refused_rigs.add(id(rig))
    return MatchBatch(tuple(item_matches), np.array(status, dtype=np.str_))


def _match_stacks(
    stacks: Iterable[list[int]],
    frames: Mapping[int, FrameInput],
    match_stack: Callable[[list[int]], list[Matches]],
) -> list[tuple[list[int], list[Matches]]]:
    """Match all stacks, and return each stack (indices of its frames) with its matches.

    Stacks of small frames are matched on threads while later frames are prepared. Large frames
    follow one by one, because their programs use all processors and much memory.
    """
    config: Any = jax.config
    device, large_stacks = config.jax_default_device, []

    def on_thread(stack: list[int]) -> list[Matches]:
        numbers = [[len(ends) for ends in frames[k].ends_px] for k in stack]
        sizes = bucket(max(map(sum, zip(*numbers, strict=True)))), bucket(len(stack))
        # Each thread has its own JAX settings.
        with jax.default_device(device), compile_once("match_frames", len(numbers[0]), *sizes):
            return in_float64(match_stack)(stack)

    with ThreadPoolExecutor(min(multiprocessing.cpu_count(), MAX_THREADS)) as threads:
        futures = []
        for stack in stacks:
            if _is_small(frames[stack[0]]):
                futures.append((stack, threads.submit(on_thread, stack)))
            else:
                large_stacks.append(stack)
        small_results = [(stack, results.result()) for stack, results in futures]
    return small_results + [(stack, match_stack(stack)) for stack in large_stacks]


def _prepare_item(
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    sigma_px: float | None,
    tuning: MatchTuning,
    camera_cache: dict[tuple[int, tuple[str, ...]], CamerasInput],
) -> FrameInput:
    """Check the segments of one frame, and convert them to the input of the matcher.

    `camera_cache` stores the checked cameras of each rig, for all frames that share the rig.
    """
    key = id(rig), tuple(segments)
    if key not in camera_cache and len(segments) > 1 and set(segments) <= set(rig.names):
        camera_cache[key] = prepare_cameras(rig, segments)
    return prepare_frame(segments, rig, sigma_px, tuning.sides, camera_cache.get(key))


def _views_and_segments(frame: FrameInput) -> tuple[int, int]:
    """Return the number of views of a frame, and the largest number of segments in one view."""
    return len(frame.names), max(len(ends) for ends in frame.ends_px)


def _is_small(frame: FrameInput) -> bool:
    views, size = _views_and_segments(frame)
    return views <= MAX_VIEWS and size <= LARGEST_FRAME


def _group_frames(frames: Iterable[tuple[int, FrameInput]]) -> Iterator[list[int]]:
    """Yield lists of frame indices. The frames of each list are matched as one problem."""
    open_stacks: dict[int, list[int]] = {}
    segment_counts: dict[int, int] = {}
    for frame_index, frame in frames:
        if not _is_small(frame):
            yield [frame_index]
            continue
        views, size = _views_and_segments(frame)
        stack = open_stacks.setdefault(views, [])
        if len(stack) == FRAMES_AT_ONCE or segment_counts.get(views, 0) + size > LARGEST_STACK:
            yield stack
            stack = open_stacks[views] = []
            segment_counts[views] = 0
        stack.append(frame_index)
        segment_counts[views] = segment_counts.get(views, 0) + size
    yield from (stack for stack in open_stacks.values() if stack)
