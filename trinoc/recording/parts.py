"""Parts of a recording: consecutive frames that are matched together, and the share of a job."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.batch import match_many
from trinoc.recording.frame_table import OK, Frame, FrameMatches


def match_part_frames(
    segments: Mapping[str, Mapping[str, Segments] | str],
    rig: Rig,
    *,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] | None = None,
) -> list[FrameMatches]:
    """Match the frames of one part of a recording.

    Parameters
    ----------
    segments : mapping of frame to segments by view, or str
        Segments of each frame, or a sentence on why it has none.
    rig : Rig
        The cameras.
    sigma_px, depth_range_mm : optional
        As in `match_segments`.

    Returns
    -------
    list of FrameMatches
        Result of each frame. All frames are matched together; if that fails, they are matched one
        by one. The status of a frame that fails, by a defect or lack of memory, is a sentence.
    """
    usable = {name: views for name, views in segments.items() if not isinstance(views, str)}

    def match_all(names: Sequence[str]) -> list[FrameMatches]:
        try:
            batch = match_many(
                [usable[name] for name in names],
                rig,
                sigma_px=sigma_px,
                depth_range_mm=depth_range_mm,
            )
        except Exception as error:
            if len(names) == 1:
                return [FrameMatches(names[0], matcher_failure(error), None)]
            return [result for name in names for result in match_all([name])]
        outcomes = zip(names, batch.matches, batch.status, strict=True)
        return [
            FrameMatches(name, OK if matches is not None else str(reason), matches)
            for name, matches, reason in outcomes
        ]

    results = {
        name: FrameMatches(name, reason, None)
        for name, reason in segments.items()
        if isinstance(reason, str)
    }
    results |= {result.name: result for result in match_all(list(usable))}
    return [results[name] for name in segments]


def matcher_failure(error: Exception) -> str:
    """Return the sentence that reports an unexpected failure of the matcher."""
    if isinstance(error, MemoryError):
        return "There is too little memory for this frame. Give smaller pictures or fewer threads."
    text = " ".join(str(error).split())[:200]
    return f"The matcher failed ({type(error).__name__}: {text}). Please report this frame."


class RecordingPart(NamedTuple):
    """Consecutive frames of a recording that are matched together.

    Attributes
    ----------
    number : int
        Index of the part in the recording, from 0.
    frames : sequence of Frame
        The frames.
    """

    number: int
    frames: tuple[Frame, ...]


def cut_into_parts(frames: Sequence[Frame], frames_per_part: int) -> list[RecordingPart]:
    """Divide frames into parts of `frames_per_part`, in order; the last part may be shorter.

    The division depends on nothing else. So any number of jobs, threads and interruptions gives the
    same files.
    """
    starts = range(0, len(frames), frames_per_part)
    return [RecordingPart(k, tuple(frames[i : i + frames_per_part])) for k, i in enumerate(starts)]


def share_parts(parts: Sequence[RecordingPart], shard: tuple[int, int]) -> list[RecordingPart]:
    """Return the parts of job i of n, counted from 1: every n-th part, so that jobs take similar
    times.

    Raises InputError if i is not from 1 to n.

    shard : (i, n).
    """
    job, jobs = shard
    if not 1 <= job <= jobs:
        raise InputError(
            f"There is no shard {job} of {jobs}. Shards are numbered from 1 to {max(jobs, 1)}."
        )
    return list(parts[job - 1 :: jobs])
