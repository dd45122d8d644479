"""Folder of results: parts to do, parts done, and a lock for one program at a time.

    recording.json            inputs and options of all files here
    matches-000012.npz        results of the frames of part 12; complete or absent
    manifest.jsonl            one line per frame; manifest-2-of-4.jsonl for job 2 of 4

A part is done when its file exists. Its manifest lines are appended after that; after an
interruption between the two they are restored from the file. When all parts of a job are done, the
lines are sorted.
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
    """Folder with the results of one job.

    Attributes
    ----------
    done : dict
        Manifest lines of each finished part, by the number of the part.
    tally : Counter
        Numbers of "frames", "failed", "suspect", "uncertain" and "tracks" so far.
    """

    def __init__(self, path: Path, ending: str, manifest: Path, stream: Any) -> None:
        self.path, self.ending, self.manifest, self._stream = path, ending, manifest, stream
        self.done: dict[int, list[dict[str, Any]]] = {}
        self.tally: Counter[str] = Counter()

    def part_file(self, number: int) -> Path:
        """Path of the result file of a part."""
        return self.path / f"matches-{number:06d}{self.ending}"

    def look(self, parts: Sequence[RecordingPart]) -> None:
        """Find the parts that are finished, and delete temporary files of an interrupted run."""
        files = {self.part_file(part.number).name: part for part in parts}
        # The manifest is locked, so no other program writes these files.
        for temporary in self.path.glob(".matches-*.tmp"):
            if temporary.name[1:].rsplit(".", 2)[0] in files:
                temporary.unlink(missing_ok=True)
        lines, existing = read_lines(self.manifest), set(os.listdir(self.path))
        for name, part in files.items():
            manifest = lines.get(name, [])
            if name not in existing:
                continue
            if [line.get("frame") for line in manifest] == [frame.name for frame in part.frames]:
                self._note(part.number, manifest)
                continue
            try:
                self._append(part.number, load_frames(self.path / name))
            except InputError:
                (self.path / name).unlink()

    def commit(self, number: int, results: Sequence[FrameMatches], views: Sequence[str]) -> None:
        """Write the result file of a part, then its manifest lines.

        Raises InputError if a file cannot be written.
        """
        save_frames(results, views, self.part_file(number))
        self._append(number, results)

    def order(self) -> None:
        """Sort the lines of the manifest by frame."""
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
    """Context manager that opens the folder of one job, and locks it against a second program.

    The folder is created if necessary. Raises InputError if it contains results of other inputs, or
    if another program uses it.

    shard : (i, n), job i of n.
    description : inputs and options that the results depend on.
    ending : file ending of the results.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        _describe(path / DESCRIPTION, description)
        job, jobs = shard
        manifest = path / ("manifest.jsonl" if jobs == 1 else f"manifest-{job}-of-{jobs}.jsonl")
        stream = open(manifest, "ab", buffering=0)  # noqa: SIM115
    except OSError as error:
        raise InputError(
            f"{path} cannot be written to ({error.strerror}). Choose another folder."
        ) from error
    with stream:
        _lock(stream, manifest)
        # Remove an incomplete last line of an interrupted program.
        os.truncate(manifest, manifest.read_bytes().rfind(b"\n") + 1)
        yield Folder(path, ending, manifest, stream)


def _describe(file: Path, description: Mapping[str, Any]) -> None:
    """Write the description of the results to a file, or compare it with the existing file.

    Raises InputError if they differ.
    """
    if not file.exists():
        write_text(file, json.dumps(description, indent=2, ensure_ascii=False) + "\n")
        return
    existing = parsed_json(read_text(file), file)
    existing = existing if isinstance(existing, dict) else {}
    for key in {**description, **existing}:
        if existing.get(key) != description.get(key):
            raise InputError(
                f'{file.parent} contains results of a run with another "{key}". To continue that '
                "run, give the same recording, rig and options; otherwise choose another folder."
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
            f"Another `trinoc batch` is writing {manifest}. Wait until that run has ended, or give "
            "each run its own shard (--shard)."
        ) from error
    except OSError:
        pass  # a file system without locks
