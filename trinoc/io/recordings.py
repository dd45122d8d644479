"""The folder of results of a batch: its manifest, and its matches read again frame by frame.

A manifest has a line of JSON for each frame, with its fate and where its matches are.
"""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trinoc.errors import InputError
from trinoc.io.frames_files import load_frames
from trinoc.match.tracks.matches import Matches
from trinoc.recording.frame import FrameMatches


def manifest_lines(results: Sequence[FrameMatches], file: str) -> list[dict[str, Any]]:
    """The lines of the frames of one file of results; equal results give equal lines."""
    return [{"frame": r.name, **_fate(r), "file": file, "row": k} for k, r in enumerate(results)]


def manifest_text(lines: Iterable[Mapping[str, Any]]) -> str:
    """Lines as they stand in a file."""
    return "".join(json.dumps(line, ensure_ascii=False) + "\n" for line in lines)


def read_lines(manifest: Path) -> dict[str, list[dict[str, Any]]]:
    """The lines of each file of results, in the order of its rows.

    Lines that are damaged are left out: the files have all that they said.
    """
    found: dict[str, dict[int, dict[str, Any]]] = {}
    for text in manifest.read_bytes().splitlines():
        try:
            line = json.loads(text)
            found.setdefault(str(line["file"]), {})[int(line["row"])] = line
        except (ValueError, TypeError, KeyError, RecursionError):
            continue
    return {file: [rows[k] for k in sorted(rows)] for file, rows in found.items()}


def _fate(result: FrameMatches) -> dict[str, Any]:
    if result.matches is None:
        return {"status": "failed", "why": result.status}
    stage = result.matches.stage
    return {
        "status": result.status,
        "segments": {view: len(words) for view, words in result.matches.reasons.items()},
        "tracks": {name: int((stage == name).sum()) for name in ("trinocular", "binocular")},
    }


class RecordingMatches(Mapping):
    """Frame names to matches, None for a frame that failed; one file is in memory at a time.

    failures : (frame name, why) of those that failed, in order.
    """

    def __init__(
        self, folder: Path, places: Mapping[str, tuple[str, int]], failures: dict[str, str]
    ) -> None:
        self.folder, self._places, self.failures = folder, places, failures
        self._last: tuple[str, list[FrameMatches]] = ("", [])

    def __len__(self) -> int:
        return len(self._places)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __getitem__(self, frame: str) -> Matches | None:
        file, row = self._places[frame]
        if self._last[0] != file:
            self._last = file, load_frames(self.folder / file)
        results = self._last[1]
        if not row < len(results) or results[row].name != frame:
            raise InputError(
                f'{self.folder / file} has no frame "{frame}" in row {row}, where the manifest '
                "says so: run the batch again."
            )
        return results[row].matches


def load_recording(folder: str | os.PathLike[str]) -> RecordingMatches:
    """The results of `match_recording`, of all jobs that wrote to the folder.

    Frames come in the order of the recording. Raises InputError where there are none.
    """
    place = Path(folder)
    lines: dict[str, list[dict]] = {}
    for manifest in sorted(place.glob("manifest*.jsonl")):
        lines |= read_lines(manifest)
    if not lines:
        raise InputError(f"{place} holds no results of trinoc batch: give its output folder.")
    places, failures = {}, {}
    for file in sorted(lines):
        if Path(file).name != file:
            raise InputError(f'A manifest in {place} names "{file}", which is outside: remove it.')
        for line in lines[file]:
            name = str(line.get("frame"))
            places[name] = file, int(line["row"])
            if line.get("status") == "failed":
                failures[name] = str(line.get("why"))
    return RecordingMatches(place, places, failures)
