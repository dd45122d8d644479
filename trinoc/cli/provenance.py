"""How a file came to be: the command, the version, and the content of what went in."""

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import trinoc


def provenance(command_line: str, inputs: Mapping[str, str | os.PathLike[str]]) -> dict[str, Any]:
    """The "provenance" object of a file; equal inputs give equal objects, so it has no date."""
    return {
        "command": command_line,
        "version": trinoc.__version__,
        "inputs": {
            name: {
                "file": Path(path).name,
                "sha256": hashlib.sha256(Path(path).read_bytes()).hexdigest(),
            }
            for name, path in inputs.items()
        },
    }


def for_people(origin: Mapping[str, Any]) -> dict[str, str]:
    """The same as lines of text, for the foot of a report."""
    files = {
        name: f"{entry['file']} (sha256 {entry['sha256'][:12]})"
        for name, entry in origin["inputs"].items()
    }
    return {"command": origin["command"], "version": origin["version"], **files}
