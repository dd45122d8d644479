"""Where pictures come from while somebody waits: cameras, videos, and folders as they fill."""

import contextlib
import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from trinoc.capture.measures import fine_contrast
from trinoc.errors import InputError
from trinoc.io.images import IMAGE_SUFFIXES, is_whole_picture, name_shots, read_image
from trinoc.io.videos import (
    Video,
    common_rate,
    compare_videos,
    open_videos,
    read_moments,
    to_picture,
)

# Scans after which a picture without its end mark, and a shot that lacks a camera's, is taken as
# it is.
PATIENCE = 10


class Moment(NamedTuple):
    """What the cameras saw at one moment, by their names: pictures, or why one is none."""

    name: str
    pictures: Mapping[str, np.ndarray | InputError]


def find_kind(place: str) -> Literal["camera", "video", "folder"]:
    """What a source is: the number of a camera, a video file, or else a folder."""
    if place.isdecimal():
        return "camera"
    return "video" if Path(place).is_file() else "folder"


def open_source(
    places: Mapping[str, str], every_s: float, *, once: bool, warn: Callable[[str], None]
) -> Iterator[Moment]:
    """The moments of a source of one kind for each camera.

    places : what the user gave, by camera; of one without a name under "". warn : takes a sentence
    on what may be wrong. Raises InputError at once for what is no such source; a camera is opened
    with the first moment.
    """
    kind = find_kind(next(iter(places.values())))
    if kind == "camera":
        return watch_cameras({name: int(place) for name, place in places.items()}, every_s)
    paths = {name: Path(place) for name, place in places.items()}
    if kind == "video":
        videos = open_videos(paths)
        for remark in compare_videos(list(videos.values())):
            warn(remark)
        return watch_videos(videos, every_s, warn)
    arrivals = {name: FolderArrivals(path) for name, path in paths.items()}
    if "" in arrivals:
        return watch_folder(arrivals[""], every_s, once=once)
    return watch_folders(arrivals, every_s, once=once)


class FolderArrivals:
    """Pictures of a folder, each once it is written to its end, and again when it is replaced."""

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(
                f"{folder} is no folder: give the one that pictures arrive in, a video, or the "
                "number of a camera."
            )
        self._folder = folder
        self._seen: dict[Path, tuple[tuple[int, int], int]] = {}
        self._told: dict[Path, tuple[int, int]] = {}

    def ready(self, *, at_once: bool = False) -> list[Path]:
        """Pictures not told yet that did not change since the last call, the oldest first.

        at_once : also those seen for the first time.
        """
        found = []
        for path in self._folder.iterdir():
            if path.suffix.lower() not in IMAGE_SUFFIXES:
                continue
            with contextlib.suppress(OSError):  # gone again, or not yet to be read
                status = path.stat()
                signature = status.st_size, status.st_mtime_ns
                before, scans = self._seen.get(path, (None, 0))
                scans = scans + 1 if before == signature else 0
                self._seen[path] = signature, scans
                if self._told.get(path) == signature or not (scans or at_once):
                    continue
                if at_once or scans >= PATIENCE or is_whole_picture(path):
                    found.append((status.st_mtime_ns, path))
                    self._told[path] = signature
        return [path for _, path in sorted(found)]


def watch_folder(arrivals: FolderArrivals, every_s: float, *, once: bool) -> Iterator[Moment]:
    """Each picture of one camera's folder; `once` ends with those that are there."""
    while True:
        for path in arrivals.ready(at_once=once):
            yield Moment(path.name, {"": _read(path)})
        if once:
            return
        time.sleep(every_s)


def watch_folders(
    arrivals: Mapping[str, FolderArrivals], every_s: float, *, once: bool
) -> Iterator[Moment]:
    """Shots of several cameras' folders, by the names of their files as `load_shots` pairs them.

    A shot that lacks a camera's picture is waited for, and told in the end without it.
    """
    there: dict[str, set[Path]] = {camera: set() for camera in arrivals}
    fresh: dict[tuple[str, Path], int] = {}
    while True:
        for camera, own in arrivals.items():
            ready = own.ready(at_once=once)
            there[camera].update(ready)
            fresh |= {(camera, path): 0 for path in ready}
        for name, files in _pair_files(there):
            waited = [fresh[each] for each in files.items() if each in fresh]
            if waited and (once or len(files) == len(there) or min(waited) >= PATIENCE):
                yield Moment(name, {camera: _read(path) for camera, path in files.items()})
                for each in files.items():
                    fresh.pop(each, None)
        if once:
            return
        fresh = {each: scans + 1 for each, scans in fresh.items()}
        time.sleep(every_s)


def _pair_files(there: Mapping[str, set[Path]]) -> list[tuple[str, dict[str, Path]]]:
    """The files of each shot, by camera."""
    files = {camera: sorted(own) for camera, own in there.items()}
    names = name_shots({camera: [file.stem for file in own] for camera, own in files.items()})
    shots: dict[str, dict[str, Path]] = {}
    for camera, own in files.items():
        for name, file in zip(names[camera], own, strict=True):
            shots.setdefault(name, {})[camera] = file
    return sorted(shots.items())


def _read(path: Path) -> np.ndarray | InputError:
    try:
        return read_image(path)
    except (InputError, OSError) as error:
        return InputError(str(error))


def watch_cameras(numbers: Mapping[str, int], every_s: float) -> Iterator[Moment]:
    """The sharpest moment of every so many seconds of cameras of this machine.

    Raises InputError for a camera that does not open, and for one that sends nothing any more.
    """
    with contextlib.ExitStack() as stack:
        cameras = {}
        for name, number in numbers.items():
            cameras[name] = cv2.VideoCapture(number)
            stack.callback(cameras[name].release)
            if not cameras[name].isOpened():
                raise InputError(f"Camera {number} does not open: see that nobody else uses it.")
        for count in itertools.count(1):
            # A camera keeps frames waiting, which are older than the last look: they are let go.
            begin = time.monotonic()
            _grab(cameras, numbers)
            while time.monotonic() < begin + 0.5 * every_s:
                _grab(cameras, numbers)
            best = _Sharpest(_retrieve(cameras, numbers))
            while time.monotonic() < begin + every_s:
                _grab(cameras, numbers)
                best.offer(_retrieve(cameras, numbers))
            yield Moment(f"picture {count}", best.pictures)


def _grab(cameras: Mapping[str, Any], numbers: Mapping[str, int]) -> None:
    # All at once, before any is decoded: as near to one moment as cameras without a trigger come.
    there = {name: camera.grab() for name, camera in cameras.items()}
    _expect_all(there, numbers)


def _retrieve(cameras: Mapping[str, Any], numbers: Mapping[str, int]) -> dict[str, np.ndarray]:
    frames = {name: camera.retrieve()[1] for name, camera in cameras.items()}
    _expect_all({name: frame is not None for name, frame in frames.items()}, numbers)
    return frames


def _expect_all(there: Mapping[str, bool], numbers: Mapping[str, int]) -> None:
    for name, is_there in there.items():
        if not is_there:
            number = numbers[name]
            raise InputError(f"Camera {number} sends no picture any more: look at its cable.")


class _Sharpest:
    """The sharpest of the moments that were offered: a board that moves makes one less so."""

    def __init__(self, frames: Mapping[str, np.ndarray], name: str = "") -> None:
        self._frames, self._contrast, self.name = frames, self._measure(frames), name

    def offer(self, frames: Mapping[str, np.ndarray], name: str = "") -> None:
        """Take the place of the sharpest, if they are sharper."""
        contrast = self._measure(frames)
        if contrast > self._contrast:
            self._frames, self._contrast, self.name = frames, contrast, name

    @staticmethod
    def _measure(frames: Mapping[str, np.ndarray]) -> float:
        # As logarithms, so that a camera that sees little counts as much as the others.
        return sum(math.log(fine_contrast(frame) + 1e-6) for frame in frames.values())

    @property
    def pictures(self) -> dict[str, np.ndarray]:
        """As files are read."""
        return {name: to_picture(frame) for name, frame in self._frames.items()}


def watch_videos(
    videos: Mapping[str, Video], every_s: float, warn: Callable[[str], None]
) -> Iterator[Moment]:
    """The sharpest moment of every so many seconds of videos in step, until the first ends."""
    rate = common_rate(videos)
    moments = ((f"{number / rate:.2f} s", own) for number, own in read_moments(videos, warn))
    while first := next(moments, None):
        best = _Sharpest(first[1], first[0])
        for name, frames in itertools.islice(moments, max(0, round(every_s * rate) - 1)):
            best.offer(frames, name)
        yield Moment(best.name, best.pictures)
