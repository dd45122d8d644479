"""Work of one worker: from the images of a part to its matches."""

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
    """Settings that all parts of a recording share. A cluster sends them to its machines."""

    folder: Path
    rig: Rig
    find: Mapping[str, Any]
    depth_range_mm: tuple[float, float] | None
    sigma_px: float | None = None


def part_results(
    work: MatchingJob, part: RecordingPart, stopped: Callable[[], bool] = lambda: False
) -> list[FrameMatches]:
    """Detect and match the segments of all frames of a part. One image is in memory at a time.

    A frame that fails has a sentence as its result. Raises CancelledError if `stopped` returns True
    between two frames.
    """
    segments: dict[str, dict[str, Segments] | str] = {}
    for frame in part.frames:
        if stopped():
            raise CancelledError
        try:
            segments[frame.name] = frame_segments(work, frame)
        except TrinocError as error:
            # Results must not depend on the folder, which may be moved between two runs.
            segments[frame.name] = str(error).replace(f"{work.folder}{os.sep}", "")
        except Exception as error:
            segments[frame.name] = matcher_failure(error)
    return match_part_frames(
        segments, work.rig, sigma_px=work.sigma_px, depth_range_mm=work.depth_range_mm
    )


def frame_segments(work: MatchingJob, frame: Frame) -> dict[str, Segments]:
    """Segments of each view of a frame, detected in its images or read from its files.

    Raises InputError if a file is missing, is not an image of its camera, or belongs to two
    cameras.
    """
    segments: dict[str, Segments] = {}
    view_of: dict[bytes, str] = {}
    for camera in work.rig.names:
        if camera not in frame.files:
            raise InputError(f'Frame "{frame.name}" has no picture of "{camera}". Add it.')
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
                f"({file}). Give the picture of each camera."
            )
        segments[camera] = find_segments(image, **work.find)
    return segments
