"""Pictures as they arrive: in a folder, or from a camera."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trinoc.errors import InputError

if TYPE_CHECKING:
    import numpy as np

# Scans after which a picture without its end mark is taken as it is.
PATIENCE = 10


class FolderArrivals:
    """Pictures of a folder, each once it is written to its end, and again when it is replaced."""

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder} is no folder: give the one that pictures arrive in.")
        self._folder = folder
        self._seen: dict[Path, tuple[tuple[int, int], int]] = {}
        self._told: dict[Path, tuple[int, int]] = {}

    def ready(self, *, at_once: bool = False) -> list[Path]:
        """Pictures not told yet that did not change since the last call, the oldest first.

        at_once : also those seen for the first time.
        """
        from trinoc.io import IMAGE_SUFFIXES, is_whole_picture

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


def camera_frames(number: int, every_s: float) -> "Iterator[np.ndarray]":
    """The newest frame of a camera, every so many seconds. Raises InputError."""
    import cv2

    camera: Any = cv2.VideoCapture(number)
    try:
        if not camera.isOpened():
            raise InputError(f"Camera {number} does not open: see that nobody else uses it.")
        while True:
            # A camera keeps frames waiting: all are taken, and the last is looked at.
            until = time.monotonic() + every_s
            there = camera.grab()
            while there and time.monotonic() < until:
                there = camera.grab()
            there, frame = camera.retrieve() if there else (False, None)
            if frame is None:
                raise InputError(f"Camera {number} sends no picture any more: look at its cable.")
            yield frame
    finally:
        camera.release()
