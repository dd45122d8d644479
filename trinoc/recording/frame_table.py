"""Frames of a recording: files and results of one time, and the CSV table that lists frames.

The table has a column "frame" and one for each camera.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from trinoc.errors import InputError, list_names
from trinoc.match.tracks.matches import Matches
from trinoc.recording.camera_aliases import camera_aliases

OK = "ok"
# Number of views from which a recording may have fewer views than the rig has cameras.
ENOUGH_VIEWS = 3


class Frame(NamedTuple):
    """One frame of a recording.

    Attributes
    ----------
    name : str
        Name of the frame.
    files : mapping of camera to str
        File of each camera, relative to the recording's folder.
    """

    name: str
    files: Mapping[str, str]


class FrameMatches(NamedTuple):
    """Result of one frame of a recording.

    Attributes
    ----------
    name : str
        Name of the frame.
    status : str
        "ok", or the reason of a failure.
    matches : Matches or None
        Matches; None after a failure.
    """

    name: str
    status: str
    matches: Matches | None


def frames_of_table(text: str, cameras: Sequence[str], where: str) -> list[Frame]:
    """Read the frames of a CSV text, in its order.

    Parameters
    ----------
    text : str
        The table. Its first line names the columns; cameras may have any name of `camera_aliases`.
        Other columns are ignored. An empty cell means no image.
    cameras : sequence of str
        Cameras of the rig.
    where : str
        Name of the table in messages.

    Returns
    -------
    list of Frame
        Files are relative to the table's folder.

    Raises
    ------
    InputError
        If a column, frame or file name is wrong; the message has the row.
    """
    try:
        rows = list(csv.reader(text.splitlines(), strict=True))
    except csv.Error as error:
        raise InputError(f"{where} is not a CSV table ({error}). Write it again.") from error
    aliases = {alias.strip(): camera for alias, camera in camera_aliases(cameras).items()}
    head = [aliases.get(name.strip(), name.strip()) for name in rows[0]] if rows else []
    listed = [camera for camera in cameras if camera in head]
    # A rig may have more cameras than a recording has views.
    views = listed if len(listed) >= ENOUGH_VIEWS else cameras
    for column in ("frame", *views):
        if head.count(column) != 1:
            raise InputError(
                f'{where} must have one column "{column}" in its first line, but has '
                f"{list_names(head) or 'none'}. Name frame, {list_names(cameras)}."
            )
    frames: dict[str, Frame] = {}
    for line, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(head):
            raise InputError(
                f"{where}, row {line}, has {len(row)} cells for {len(head)} columns. Correct it."
            )
        cells = dict(zip(head, (cell.strip() for cell in row), strict=True))
        name = cells["frame"]
        if not name or name in frames:
            problem = f'names the frame "{name}" again' if name else "names no frame"
            raise InputError(f"{where}, row {line}, {problem}. Give each frame its own name.")
        files = {camera: cells[camera] for camera in views if cells[camera]}
        for file in files.values():
            _expect_inside(file, f"{where}, row {line}")
        frames[name] = Frame(name, files)
    if not frames:
        raise InputError(f"{where} lists no frame. Add a row for each frame.")
    return list(frames.values())


def _expect_inside(file: str, where: str) -> None:
    leaves = file.startswith(("/", "\\", "~")) or re.match(r"[A-Za-z]:", file)
    if leaves or ".." in re.split(r"[/\\]", file) or not file.isprintable():
        raise InputError(
            f"{where}, names the file {file!r}, which is not inside the table's folder. Name files "
            "relative to that folder."
        )
