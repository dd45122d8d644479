"""The folder of results: what is to be done, what is done, and one program at a time.

    recording.json            what every file here was made from, and how
    matches-000012.npz        what became of the frames of part 12; there or not, never in part
    manifest.jsonl            a line for each frame; manifest-2-of-4.jsonl of job 2 of 4

A part is done when its file is there. Its lines are appended to the manifest after that, so that a
kill between the two is mended from the file. When all parts of a job are done, the lines are put
in order.
"""

import contextlib
import json
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trinoc.errors import InputError
from trinoc.io.atomic import read_text, write_text
from trinoc.io.frames_files import (
    load_frames,
    manifest_lines,
    manifest_text,
    read_lines,
    save_frames,
)
from trinoc.io.json_document import parsed_json
from trinoc.recording.frame_table import OK, FrameMatches
from trinoc.recording.parts import RecordingPart

DESCRIPTION = "recording.json"


class Folder:
    """Results of one job in a folder.

    done : number of a part to its manifest lines. tally : "frames", "failed", "suspect",
    "uncertain" and "tracks" of all.
    """

    def __init__(self, path: Path, ending: str, manifest: Path, stream: Any) -> None:
        self.path, self.ending, self.manifest, self._stream = path, ending, manifest, stream
        self.done: dict[int, list[dict[str, Any]]] = {}
        self.tally: Counter[str] = Counter()

    def part_file(self, number: int) -> Path:
        """The file of a part."""
        return self.path / f"matches-{number:06d}{self.ending}"

    def look(self, parts: Sequence[RecordingPart]) -> None:
        """Find out which parts are done; sweep what a killed program left of the others."""
        files = {self.part_file(part.number).name: part for part in parts}
        # The manifest is locked: nobody else writes these.
        for left in self.path.glob(".matches-*.tmp"):
            if left.name[1:].rsplit(".", 2)[0] in files:
                left.unlink(missing_ok=True)
        lines, there = read_lines(self.manifest), set(os.listdir(self.path))
        for name, part in files.items():
            known = lines.get(name, [])
            if name not in there:
                continue
            if [line.get("frame") for line in known] == [frame.name for frame in part.frames]:
                self._note(part.number, known)
                continue
            try:
                self._append(part.number, load_frames(self.path / name))
            except InputError:
                (self.path / name).unlink()

    def commit(self, number: int, results: Sequence[FrameMatches], views: Sequence[str]) -> None:
        """Write a part, then its lines. Raises InputError where the disk does not take it."""
        save_frames(results, views, self.part_file(number))
        self._append(number, results)

    def order(self) -> None:
        """Put the lines in the order of the frames."""
        lines = (line for number in sorted(self.done) for line in self.done[number])
        write_text(self.manifest, manifest_text(lines))

    def _append(self, number: int, results: Sequence[FrameMatches]) -> None:
        lines = manifest_lines(results, self.part_file(number).name)
        self._stream.write(manifest_text(lines).encode("utf-8"))
        self._note(number, lines)

    def _note(self, number: int, lines: list[dict[str, Any]]) -> None:
        self.done[number] = lines
        for line in lines:
            self.tally["frames"] += 1
            self.tally["failed"] += line["status"] != OK
            self.tally["suspect"] += "suspect" in line
            self.tally["uncertain"] += "uncertain" in line
            self.tally["tracks"] += sum(line.get("tracks", {}).values())


@contextlib.contextmanager
def open_results(
    path: Path, shard: tuple[int, int], description: Mapping[str, Any], ending: str
) -> Iterator[Folder]:
    """The folder for one job, made where it is not there, and locked against a second program.

    Raises InputError where it holds the results of something else, or is in use.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        _describe(path / DESCRIPTION, description)
        job, jobs = shard
        manifest = path / ("manifest.jsonl" if jobs == 1 else f"manifest-{job}-of-{jobs}.jsonl")
        stream = open(manifest, "ab", buffering=0)  # noqa: SIM115
    except OSError as error:
        raise InputError(
            f"{path} cannot be written to ({error.strerror}): choose another folder."
        ) from error
    with stream:
        _lock(stream, manifest)
        # What a kill left of the last line goes, so that the next line begins anew.
        os.truncate(manifest, manifest.read_bytes().rfind(b"\n") + 1)
        yield Folder(path, ending, manifest, stream)


def _describe(file: Path, description: Mapping[str, Any]) -> None:
    """Write what the results are made from, or compare it with what stands there."""
    if not file.exists():
        write_text(file, json.dumps(description, indent=2, ensure_ascii=False) + "\n")
        return
    there = parsed_json(read_text(file), file)
    there = there if isinstance(there, dict) else {}
    for key in {**description, **there}:
        if there.get(key) != description.get(key):
            raise InputError(
                f'{file.parent} holds results that differ in "{key}": give the same recording, '
                "rig and options to go on with them, or choose another folder."
            )


def _lock(stream: Any, manifest: Path) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        return
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(
            f"Another trinoc batch is writing {manifest}: let it end, or give each its own shard."
        ) from error
    except OSError:
        pass  # a file system without locks
