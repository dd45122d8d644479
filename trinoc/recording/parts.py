"""How a recording is cut up: parts of some frames each, and jobs that have a share of the parts."""

from collections.abc import Sequence
from typing import NamedTuple

from trinoc.errors import InputError
from trinoc.recording.frame import Frame


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
