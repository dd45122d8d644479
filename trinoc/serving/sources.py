"""Sources of live images: cameras, videos, and folders that fill."""

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

# Number of scans after which an image without end mark, or an incomplete shot, is accepted.
PATIENCE = 10


class Moment(NamedTuple):
    """Images of all cameras at one time, by camera name.

    An image that is not readable is replaced by its InputError.
    """

    name: str
    pictures: Mapping[str, np.ndarray | InputError]


def find_kind(source: str) -> Literal["camera", "video", "folder"]:
    """Return the kind of a source: "camera" for a number, "video" for a file, else "folder"."""
    if source.isdecimal():
        return "camera"
    return "video" if Path(source).is_file() else "folder"


def open_source(
    sources: Mapping[str, str], every_s: float, *, once: bool, warn: Callable[[str], None]
) -> Iterator[Moment]:
    """Yield the moments of the cameras' sources, which are all of one kind.

    Parameters
    ----------
    sources : mapping of camera to str
        Source of each camera; "" is the name of a single unnamed camera.
    every_s : float
        Interval between moments, in seconds.
    once : bool
        True to read only the existing images of a folder.
    warn : callable
        Function that receives sentences on possible mistakes.

    Raises
    ------
    InputError
        When called, if a source is invalid; at the first moment, if a camera does not open.
    """
    kind = find_kind(next(iter(sources.values())))
    if kind == "camera":
        return watch_cameras({name: int(source) for name, source in sources.items()}, every_s)
    paths = {name: Path(source) for name, source in sources.items()}
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
    """New images of one folder.

    An image is returned after it is completely written, and again after it has changed.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(
                f"{folder} is not a folder. Give the folder in which pictures arrive, a video, or "
                "the number of a camera."
            )
        self._folder = folder
        # Signature of each file at the last scan with the number of scans without a change, and
        # signature of each file when it was returned.
        self._scanned: dict[Path, tuple[tuple[int, int], int]] = {}
        self._returned: dict[Path, tuple[int, int]] = {}

    def ready(self, *, immediately: bool = False) -> list[Path]:
        """Return the new images that are completely written, oldest first.

        immediately : True to include images that were not yet found by an earlier call.
        """
        arrived = []
        for path in self._folder.iterdir():
            if path.suffix.lower() not in IMAGE_SUFFIXES:
                continue
            with contextlib.suppress(OSError):  # gone again, or not yet to be read
                status = path.stat()
                signature = status.st_size, status.st_mtime_ns
                previous, scans = self._scanned.get(path, (None, 0))
                scans = scans + 1 if previous == signature else 0
                self._scanned[path] = signature, scans
                if self._returned.get(path) == signature or not (scans or immediately):
                    continue
                if immediately or scans >= PATIENCE or is_whole_picture(path):
                    arrived.append((status.st_mtime_ns, path))
                    self._returned[path] = signature
        return [path for _, path in sorted(arrived)]


def watch_folder(arrivals: FolderArrivals, every_s: float, *, once: bool) -> Iterator[Moment]:
    """Yield the images of one camera's folder. once : True for the existing images only."""
    while True:
        for path in arrivals.ready(immediately=once):
            yield Moment(path.name, {"": _read(path)})
        if once:
            return
        time.sleep(every_s)


def watch_folders(
    arrivals: Mapping[str, FolderArrivals], every_s: float, *, once: bool
) -> Iterator[Moment]:
    """Yield the shots of several cameras' folders, paired by file names as in `load_shots`.

    An incomplete shot is yielded after PATIENCE scans of the folders.
    """
    existing: dict[str, set[Path]] = {camera: set() for camera in arrivals}
    scans_waited: dict[tuple[str, Path], int] = {}
    while True:
        for camera, camera_arrivals in arrivals.items():
            new_files = camera_arrivals.ready(immediately=once)
            existing[camera].update(new_files)
            scans_waited |= {(camera, path): 0 for path in new_files}
        for name, files in _pair_files(existing):
            waits = [scans_waited[item] for item in files.items() if item in scans_waited]
            if waits and (once or len(files) == len(existing) or min(waits) >= PATIENCE):
                yield Moment(name, {camera: _read(path) for camera, path in files.items()})
                for item in files.items():
                    scans_waited.pop(item, None)
        if once:
            return
        scans_waited = {item: scans + 1 for item, scans in scans_waited.items()}
        time.sleep(every_s)


def _pair_files(existing: Mapping[str, set[Path]]) -> list[tuple[str, dict[str, Path]]]:
    """Return (name, files by camera) of each shot, sorted by name."""
    files = {camera: sorted(camera_files) for camera, camera_files in existing.items()}
    names = name_shots(
        {camera: [file.stem for file in camera_files] for camera, camera_files in files.items()}
    )
    shots: dict[str, dict[str, Path]] = {}
    for camera, camera_files in files.items():
        for name, file in zip(names[camera], camera_files, strict=True):
            shots.setdefault(name, {})[camera] = file
    return sorted(shots.items())


def _read(path: Path) -> np.ndarray | InputError:
    try:
        return read_image(path)
    except (InputError, OSError) as error:
        return InputError(str(error))


def watch_cameras(numbers: Mapping[str, int], every_s: float) -> Iterator[Moment]:
    """Yield the sharpest moment of every interval of `every_s` seconds, from cameras of this
    machine.

    Raises InputError if a camera does not open or stops sending images.

    numbers : number of each camera in OpenCV, by name.
    """
    with contextlib.ExitStack() as stack:
        cameras = {}
        for name, number in numbers.items():
            cameras[name] = cv2.VideoCapture(number)
            stack.callback(cameras[name].release)
            if not cameras[name].isOpened():
                raise InputError(
                    f"Camera {number} does not open. Check that no other program uses it."
                )
        for count in itertools.count(1):
            # Frames in the camera's buffer are older than the last call and are discarded.
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
    # All cameras before any decoding: the best synchronisation without a trigger.
    grabbed = {name: camera.grab() for name, camera in cameras.items()}
    _expect_all(grabbed, numbers)


def _retrieve(cameras: Mapping[str, Any], numbers: Mapping[str, int]) -> dict[str, np.ndarray]:
    frames = {name: camera.retrieve()[1] for name, camera in cameras.items()}
    _expect_all({name: frame is not None for name, frame in frames.items()}, numbers)
    return frames


def _expect_all(received: Mapping[str, bool], numbers: Mapping[str, int]) -> None:
    for name, is_received in received.items():
        if not is_received:
            number = numbers[name]
            raise InputError(f"Camera {number} stopped sending pictures. Check its cable.")


class _Sharpest:
    """Sharpest moment of an interval. A moving board blurs the image."""

    def __init__(self, frames: Mapping[str, np.ndarray], name: str = "") -> None:
        self._frames, self._contrast, self.name = frames, self._measure(frames), name

    def offer(self, frames: Mapping[str, np.ndarray], name: str = "") -> None:
        """Replace the stored images if these are sharper."""
        contrast = self._measure(frames)
        if contrast > self._contrast:
            self._frames, self._contrast, self.name = frames, contrast, name

    @staticmethod
    def _measure(frames: Mapping[str, np.ndarray]) -> float:
        # Logarithms give all cameras the same weight, whatever their contrast.
        return sum(math.log(fine_contrast(frame) + 1e-6) for frame in frames.values())

    @property
    def pictures(self) -> dict[str, np.ndarray]:
        """Images of the sharpest moment, in the channel order of `read_image`."""
        return {name: to_picture(frame) for name, frame in self._frames.items()}


def watch_videos(
    videos: Mapping[str, Video], every_s: float, warn: Callable[[str], None]
) -> Iterator[Moment]:
    """Yield the sharpest moment of every interval of synchronised videos, until the first video
    ends.
    """
    rate = common_rate(videos)
    moments = ((f"{number / rate:.2f} s", frames) for number, frames in read_moments(videos, warn))
    while first := next(moments, None):
        best = _Sharpest(first[1], first[0])
        for name, frames in itertools.islice(moments, max(0, round(every_s * rate) - 1)):
            best.offer(frames, name)
        yield Moment(best.name, best.pictures)
