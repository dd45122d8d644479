"""Synchronous videos of several cameras: frames at common moments, also as PNG files."""

import contextlib
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import UInt8

from trinoc.errors import InputError
from trinoc.io.images import IMAGE_SUFFIXES, silent_opencv, write_picture

# Of a video that does not say how many it has.
_FRAMES_PER_S = 30.0
# How FFmpeg is told to say nothing on stderr about damaged frames: a sentence says more.
_FFMPEG_LOG = "OPENCV_FFMPEG_LOGLEVEL", "-8"


class Video(NamedTuple):
    """A video file and the properties that its header states.

    Attributes
    ----------
    file : Path
        The file.
    frames : int
        Number of frames; 0 if unknown. The last frame may be missing.
    frames_per_s : float
        Frame rate.
    size_px : (width, height)
        Size of the frames.
    turned_deg : int
        Rotation, degrees, that a player applies. trinoc does not apply it.
    """

    file: Path
    frames: int
    frames_per_s: float
    size_px: tuple[int, int]
    turned_deg: int


def open_videos(files: Mapping[str, Path]) -> dict[str, Video]:
    """Read the header of each camera's video.

    Raise `InputError` for a file without a readable frame, and for videos of different frame rates.
    """
    videos = {name: _read_heading(file) for name, file in files.items()}
    first = next(iter(videos.values()))
    for other in videos.values():
        if abs(other.frames_per_s - first.frames_per_s) > 0.01 * first.frames_per_s:
            raise InputError(
                f"{first.file} has {first.frames_per_s:g} frames a second and {other.file} "
                f"{other.frames_per_s:g}, so frames of equal numbers have different times: give "
                "videos that were taken at one frame rate."
            )
    return videos


def compare_videos(videos: Sequence[Video]) -> list[str]:
    """Return warnings about the videos of one rig: unequal lengths or sizes, rotation tags."""
    warning_texts = []
    counted = [video for video in videos if video.frames]
    shortest, longest = (f(counted or videos, key=lambda video: video.frames) for f in (min, max))
    if longest.frames - shortest.frames > 1:
        warning_texts.append(
            f"{longest.file} has {longest.frames} frames and {shortest.file} {shortest.frames}: "
            "frames of equal numbers are assumed simultaneous, so check that all videos begin at "
            "one moment."
        )
    first = videos[0]
    other = next((video for video in videos if video.size_px != first.size_px), None)
    if other is not None:
        sizes = ["{} x {} px".format(*video.size_px) for video in (first, other)]
        warning_texts.append(
            f"{first.file} is {sizes[0]} and {other.file} {sizes[1]}: check that these are the "
            "sizes that the cameras were calibrated for."
        )
    warning_texts += [
        f"{video.file} has a tag to rotate it by {video.turned_deg} degrees in viewers: trinoc "
        "uses the pixels of the sensor."
        for video in videos
        if video.turned_deg
    ]
    return warning_texts


def read_moments(
    videos: Mapping[str, Video], warn: Callable[[str], None], *, step: int = 1
) -> Iterator[tuple[int, Mapping[str, UInt8[np.ndarray, "..."]]]]:
    """Iterate over the moments at which all videos have a frame.

    A moment is a time step of the common frame rate. The iteration ends with the shortest video.

    Parameters
    ----------
    videos : dict of Video
        Video of each camera.
    warn : callable
        Receives a sentence about frames that could not be read.
    step : int
        Interval between moments: 1 for all.

    Yields
    ------
    (int, dict of arrays)
        Number of the moment, from 0, and the frame of each camera as OpenCV returns it.
    """
    rate = common_rate(videos)
    with contextlib.ExitStack() as stack:
        readers = {name: _VideoReader(video.file, rate) for name, video in videos.items()}
        for reader in readers.values():
            stack.callback(reader.capture.release)
        lacking: Counter[str] = Counter()
        next_number = 0
        while _find_moment(readers, lacking):
            number = next(iter(readers.values())).number
            if number >= next_number:
                yield number, {name: r.capture.retrieve()[1] for name, r in readers.items()}
                next_number = number - number % step + step
        for name, video in videos.items():
            _expect_whole(video, readers[name], lacking[name], warn)


def common_rate(videos: Mapping[str, Video]) -> float:
    """Largest frame rate of the videos, 1/s. A video with dropped frames states a smaller rate."""
    return max(video.frames_per_s for video in videos.values())


def _find_moment(readers: "Mapping[str, _VideoReader]", lacking: Counter[str]) -> bool:
    """Advance all readers to the next moment at which all videos have a frame.

    Return False if a video has ended.

    `lacking` counts for each video the moments at which it has no frame, and is updated.
    """
    late_names = list(readers)
    while late_names:
        has_frame = [readers[name].advance() for name in late_names]
        if not all(has_frame):
            return False
        latest = max(reader.number for reader in readers.values())
        late_names = [name for name, reader in readers.items() if reader.number < latest]
        if late_names:
            lacking.update(set(readers) - set(late_names))
    return True


def _expect_whole(
    video: Video, reader: "_VideoReader", lacking: int, warn: Callable[[str], None]
) -> None:
    if reader.has_ended and reader.count < video.frames:
        warn(
            f"{video.file} states {video.frames} frames, but only {reader.count} can be read, and "
            "if a frame before the end is missing, later frames have wrong times: copy the video "
            "again."
        )
    if lacking:
        warn(
            f"{video.file} has no frame at {lacking} of the moments of the other videos: these "
            "moments are left out."
        )


class _VideoReader:
    """Reader of one video; `number` is the index of the current moment, from the time stamp."""

    def __init__(self, file: Path, rate: float) -> None:
        self.capture, self._rate = _open(file), rate
        self.number, self.count, self.has_ended, self._begin_ms = -1, 0, False, 0.0

    def advance(self) -> bool:
        """Go to the next frame. Return False at the end of the video or at a damaged frame."""
        if not self.capture.grab():
            self.has_ended = True
            return False
        now_ms = self.capture.get(cv2.CAP_PROP_POS_MSEC)
        if not self.count:
            self._begin_ms = now_ms
        # A clock that stands still counts for nothing.
        by_clock = round((now_ms - self._begin_ms) * 1e-3 * self._rate)
        self.number = max(self.number + 1, by_clock)
        self.count += 1
        return True


def _read_heading(file: Path) -> Video:
    if not file.exists():
        raise InputError(f"{file} does not exist: check the name.")
    if file.is_dir():
        raise InputError(f"{file} is a folder: give the video file of one camera.")
    if file.suffix.lower() in IMAGE_SUFFIXES:
        raise InputError(f"{file} is a picture: give the video of one camera.")
    capture = _open(file)
    try:
        if not capture.isOpened():
            raise InputError(
                f"{file} is no video that OpenCV reads, or cut off: copy it again, or give another "
                "format, such as MP4 or AVI."
            )
        if not capture.grab():
            raise InputError(f"{file} holds no frame: record it again, or copy it again.")
        height, width = capture.retrieve()[1].shape[:2]
        rate, frames, rotation_deg = (
            capture.get(each)
            for each in (
                cv2.CAP_PROP_FPS,
                cv2.CAP_PROP_FRAME_COUNT,
                cv2.CAP_PROP_ORIENTATION_META,
            )
        )
    finally:
        capture.release()
    rate = rate if 0.0 < rate < 1e5 else _FRAMES_PER_S
    return Video(file, max(0, int(frames)), rate, (width, height), int(rotation_deg) % 360)


def _open(file: Path) -> Any:
    os.environ.setdefault(*_FFMPEG_LOG)
    with silent_opencv():
        capture = cv2.VideoCapture(str(file))
    # Pixels stay where the sensor had them, as in `read_image`.
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return capture


def to_picture(frame: UInt8[np.ndarray, "..."]) -> UInt8[np.ndarray, "..."]:
    """Convert a frame of OpenCV (blue, green, red) to an image as `read_image` returns it.

    The image has red, green, blue, or grey levels if the three channels are equal.
    """
    if frame.ndim == 2:
        return frame
    blue, green, red = np.moveaxis(frame, 2, 0)
    if np.array_equal(blue, green) and np.array_equal(green, red):
        return blue
    return cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)


def expect_folder_name(camera: str) -> None:
    """Raise `InputError` for a camera name that cannot be the name of a folder."""
    if Path(camera).name != camera or camera.startswith("."):
        raise InputError(
            f'"{camera}" is not allowed as the name of a folder: give the camera another name.'
        )


def write_frames(
    videos: Mapping[str, Video], folder: Path, every_s: float, warn: Callable[[str], None]
) -> int:
    """Write frames of all cameras as images such as left/000123.png; return the number of moments.

    Parameters
    ----------
    videos : dict of Video
        Video of each camera.
    folder : Path
        New or empty folder. Each camera gets a folder in it.
    every_s : float
        Time between two written moments, s; 0 for all.
    warn : callable
        Receives a sentence about frames that could not be read.

    Returns
    -------
    int
        Number of written moments.

    Raises
    ------
    InputError
        If the folder contains files, or a camera name cannot be a folder name.
    """
    for name in videos:
        expect_folder_name(name)
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise InputError(f"{folder} is a file or contains files: give a new or an empty folder.")
    for name in videos:
        (folder / name).mkdir(parents=True, exist_ok=True)
    step = max(1, round(every_s * common_rate(videos)))
    count = 0
    for number, frames in read_moments(videos, warn, step=step):
        for name, frame in frames.items():
            write_picture(folder / name / f"{number:06d}.png", to_picture(frame))
        count += 1
    return count
