"""One moment of a recording: its files, and what was found in them. The table that lists frames has
a column "frame" and a column for each camera.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from trinoc.errors import InputError, list_names
from trinoc.match.tracks.matches import Matches
from trinoc.recording.camera_words import camera_words

OK = "ok"
# From as many views on, those of a recording may be fewer than the cameras of its rig.
ENOUGH_VIEWS = 3


class Frame(NamedTuple):
    """A name, and for each camera that has one its file, relative to the recording's folder."""

    name: str
    files: Mapping[str, str]


class FrameMatches(NamedTuple):
    """What became of a frame: matches and the status "ok", or None and the sentence why not."""

    name: str
    status: str
    matches: Matches | None


def frames_of_table(text: str, cameras: Sequence[str], where: str) -> list[Frame]:
    """The frames of a CSV text, in its order; `where` names it in errors.

    Its first line names the columns, cameras by any of `camera_words`; those of no camera are read
    over, and an empty cell is a camera without a picture. Files are named relative to the table's
    folder, and may not lie outside it. Raises InputError, with the line.
    """
    try:
        rows = list(csv.reader(text.splitlines(), strict=True))
    except csv.Error as error:
        raise InputError(f"{where} is not a table in CSV ({error}): write it again.") from error
    words = {word.strip(): camera for word, camera in camera_words(cameras).items()}
    head = [words.get(name.strip(), name.strip()) for name in rows[0]] if rows else []
    named = [camera for camera in cameras if camera in head]
    # A rig may have more cameras than a recording has views.
    wanted = named if len(named) >= ENOUGH_VIEWS else cameras
    for column in ("frame", *wanted):
        if head.count(column) != 1:
            raise InputError(
                f'{where} must have one column "{column}" in its first line, but has '
                f"{list_names(head) or 'none'}: name frame, {list_names(cameras)}."
            )
    frames: dict[str, Frame] = {}
    for line, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(head):
            raise InputError(
                f"{where}, row {line}, has {len(row)} cells under {len(head)} names: correct it."
            )
        cells = dict(zip(head, (cell.strip() for cell in row), strict=True))
        name = cells["frame"]
        if not name or name in frames:
            problem = f'names the frame "{name}" again' if name else "names no frame"
            raise InputError(f"{where}, row {line}, {problem}: give each frame one name.")
        files = {camera: cells[camera] for camera in wanted if cells[camera]}
        for file in files.values():
            _expect_inside(file, f"{where}, row {line}")
        frames[name] = Frame(name, files)
    if not frames:
        raise InputError(f"{where} lists no frame: add a row for each.")
    return list(frames.values())


def _expect_inside(file: str, where: str) -> None:
    leaves = file.startswith(("/", "\\", "~")) or re.match(r"[A-Za-z]:", file)
    if leaves or ".." in re.split(r"[/\\]", file) or not file.isprintable():
        raise InputError(
            f"{where}, names the file {file!r}, which is not inside the table's folder: name files "
            "relative to that folder."
        )
