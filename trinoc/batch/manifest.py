"""The manifest: a line of JSON for each frame, with its fate and where its matches are."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trinoc.recording.frame import FrameMatches


def lines_of(results: Sequence[FrameMatches], file: str) -> list[dict[str, Any]]:
    """The lines of the frames of one file of results; equal results give equal lines."""
    return [{"frame": r.name, **_fate(r), "file": file, "row": k} for k, r in enumerate(results)]


def text_of(lines: Iterable[Mapping[str, Any]]) -> str:
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
