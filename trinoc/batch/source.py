"""Frames of a recording in a folder or a table."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from trinoc.errors import InputError, expect_path
from trinoc.io.atomic import read_text
from trinoc.io.images import IMAGE_SUFFIXES, refuse_videos
from trinoc.recording.frame_table import ENOUGH_VIEWS, Frame, frames_of_table
from trinoc.recording.name_templates import fitting_template, folder_depth, frames_of_names

SEGMENT_SUFFIXES = (".npz", ".npy", ".csv", ".txt")


class Source(NamedTuple):
    """Frames of a recording.

    Attributes
    ----------
    folder : Path
        Folder that the files of the frames are relative to.
    frames : sequence of Frame
        The frames.
    views : tuple of str
        Cameras that each frame must have: those that have a file in any frame, if these are three
        or more; otherwise all cameras of the rig.
    """

    folder: Path
    frames: list[Frame]
    views: tuple[str, ...]


def find_frames(
    location: str | os.PathLike[str], cameras: Sequence[str], template: str | None = None
) -> Source:
    """Find the frames of a folder or of a CSV table.

    Raises InputError if there is no frame.

    location : the folder or table.
    cameras : cameras of the rig.
    template : template of the file names; None to try the usual ones.
    """
    expect_path(location)
    path = Path(location)
    if path.suffix.lower() == ".csv" and not path.is_dir():
        if template is not None:
            raise InputError(
                f"{path} lists the files itself, so a template is not used. Omit the template."
            )
        frames = frames_of_table(read_text(path), cameras, str(path))
        return Source(path.parent, frames, _views(frames, cameras))
    if not path.is_dir():
        refuse_videos([path])
        raise InputError(
            f"{path} is neither a folder nor a CSV table. Give the folder of the recording."
        )
    try:
        folders = max(camera.count("/") for camera in cameras)
        depth = folders + (1 if template is None else folder_depth(template))
        names = sorted(_files(path, depth))
    except OSError as error:
        raise InputError(f"{error.filename} cannot be listed ({error.strerror}).") from error
    if template is None:
        suffixes = (*IMAGE_SUFFIXES, *SEGMENT_SUFFIXES)
        files = [path / name for name in names]
        names = [name for name in names if name.lower().endswith(suffixes)]
        if not names:
            refuse_videos(files)
            raise InputError(
                f"{path} has no pictures and no segments. Give the folder of the recording, or a "
                "CSV table that lists its files."
            )
        template = fitting_template(names, cameras)
    frames = frames_of_names(names, template, cameras)
    return Source(path, frames, _views(frames, cameras))


def _views(frames: Sequence[Frame], cameras: Sequence[str]) -> tuple[str, ...]:
    """Cameras with a file in any frame if there are three or more, otherwise all cameras."""
    cameras_with_files = set().union(*(frame.files for frame in frames))
    return tuple(
        c for c in cameras if c in cameras_with_files or len(cameras_with_files) < ENOUGH_VIEWS
    )


def _files(folder: Path, depth: int, prefix: str = "") -> Iterator[str]:
    """Yield the names of files at most `depth` folders deep, without hidden files.

    prefix : path of the folder in the names.
    """
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith("."):
                continue
            if entry.is_file():
                yield prefix + entry.name
            elif depth > 0 and entry.is_dir():
                yield from _files(folder / entry.name, depth - 1, f"{prefix}{entry.name}/")
