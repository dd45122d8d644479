"""What a batch wrote, read again frame by frame."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from trinoc.batch.manifest import read_lines
from trinoc.errors import InputError
from trinoc.io.frames_files import load_frames
from trinoc.match.tracks.matches import Matches
from trinoc.recording.frame import FrameMatches


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
