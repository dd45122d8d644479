"""A recording is cut into parts of some frames each, which are matched together; jobs have a share
of the parts.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.batch import match_many
from trinoc.recording.frame_table import OK, Frame, FrameMatches


def match_part_frames(
    found: Mapping[str, Mapping[str, Segments] | str],
    rig: Rig,
    *,
    depth_range_mm: tuple[float, float] | None = None,
) -> list[FrameMatches]:
    """What becomes of each frame, given its segments, or the sentence why it has none.

    The frames go to the matcher together. Where that fails as a whole they go one by one, and the
    one that fails, be it by a defect of this package or for want of memory, has a sentence that
    says so.
    """
    usable = {name: views for name, views in found.items() if not isinstance(views, str)}

    def match_all(names: Sequence[str]) -> list[FrameMatches]:
        try:
            batch = match_many([usable[n] for n in names], rig, depth_range_mm=depth_range_mm)
        except Exception as error:
            if len(names) == 1:
                return [FrameMatches(names[0], matcher_failure(error), None)]
            return [result for name in names for result in match_all([name])]
        outcomes = zip(names, batch.matches, batch.status, strict=True)
        return [FrameMatches(n, OK if m is not None else str(why), m) for n, m, why in outcomes]

    of_name = {n: FrameMatches(n, why, None) for n, why in found.items() if isinstance(why, str)}
    of_name |= {result.name: result for result in match_all(list(usable))}
    return [of_name[name] for name in found]


def matcher_failure(error: Exception) -> str:
    """The sentence for a failure that nobody foresaw."""
    if isinstance(error, MemoryError):
        return "The memory does not suffice for this frame: give smaller pictures or fewer threads."
    said = " ".join(str(error).split())[:200]
    return f"The matcher failed ({type(error).__name__}: {said}): please report this frame."


class RecordingPart(NamedTuple):
    """Frames in a row; `number` counts the parts of the whole recording from 0."""

    number: int
    frames: tuple[Frame, ...]


def cut_into_parts(frames: Sequence[Frame], frames_per_part: int) -> list[RecordingPart]:
    """All frames, in order, in parts of that many; the last may have fewer.

    The cut depends on nothing else, so that any number of jobs, threads and interruptions gives
    the same files.
    """
    starts = range(0, len(frames), frames_per_part)
    return [RecordingPart(k, tuple(frames[i : i + frames_per_part])) for k, i in enumerate(starts)]


def share_parts(parts: Sequence[RecordingPart], shard: tuple[int, int]) -> list[RecordingPart]:
    """The parts of job i of n, counted from 1: each n-th, so that all jobs take as long.

    Raises InputError where there is no such job.
    """
    job, jobs = shard
    if not 1 <= job <= jobs:
        raise InputError(f"There is no shard {job} of {jobs}: count from 1/{max(jobs, 1)} on.")
    return list(parts[job - 1 :: jobs])
