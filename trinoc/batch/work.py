"""What one worker does: the pictures of the frames of a part to their matches."""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any, NamedTuple

from trinoc.batch.source import SEGMENT_SUFFIXES
from trinoc.errors import InputError, TrinocError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io.images import expect_inside, expect_size, picture_digest, read_image
from trinoc.io.segment_table import load_segments
from trinoc.recording.frame_table import Frame, FrameMatches
from trinoc.recording.parts import RecordingPart, match_part_frames, matcher_failure
from trinoc.segments.find import find_segments


class MatchingJob(NamedTuple):
    """All that is needed beside the part; it travels to the machines of a cluster."""

    folder: Path
    rig: Rig
    find: Mapping[str, Any]
    depth_range_mm: tuple[float, float] | None


def part_results(
    work: MatchingJob, part: RecordingPart, stopped: Callable[[], bool] = lambda: False
) -> list[FrameMatches]:
    """What becomes of each frame. One picture is in memory at a time.

    Raises CancelledError where `stopped` says so between two frames; no frame's failure is raised.
    """
    found: dict[str, dict[str, Segments] | str] = {}
    for frame in part.frames:
        if stopped():
            raise CancelledError
        try:
            found[frame.name] = frame_segments(work, frame)
        except TrinocError as error:
            # The recording may be moved between two runs: its folder is no part of the answer.
            found[frame.name] = str(error).replace(f"{work.folder}{os.sep}", "")
        except Exception as error:
            found[frame.name] = matcher_failure(error)
    return match_part_frames(found, work.rig, depth_range_mm=work.depth_range_mm)


def frame_segments(work: MatchingJob, frame: Frame) -> dict[str, Segments]:
    """The segments of each view of a frame, found in its pictures or read from its files.

    Raises InputError where a file is not there, is no picture of its camera, or stands twice.
    """
    segments: dict[str, Segments] = {}
    view_of: dict[bytes, str] = {}
    for camera in work.rig.names:
        if camera not in frame.files:
            raise InputError(f'Frame "{frame.name}" has no picture of "{camera}": add it.')
        file = work.folder / frame.files[camera]
        if file.suffix.lower() in SEGMENT_SUFFIXES:
            segments[camera] = load_segments(file)
            expect_inside(camera, segments[camera], work.rig, file)
            continue
        image = read_image(file)
        expect_size(camera, image, work.rig)
        other = view_of.setdefault(picture_digest(image), camera)
        if other != camera:
            raise InputError(
                f'Views "{other}" and "{camera}" of frame "{frame.name}" are the same picture '
                f"({file}): give the picture that each camera took."
            )
        segments[camera] = find_segments(image, **work.find)
    return segments
