"""`--dry-run`: what a command would do."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from trinoc.cli.command import Outcome


def plan(
    what: str,
    files: Mapping[str, Path],
    sizes_px: Mapping[str, tuple[int, int]],
    outputs: Sequence[Path | None],
) -> Outcome:
    """The job in words, each camera with its file and size, and what would be written."""
    lines = [f"would {what}:"]
    for name, file in files.items():
        width, height = sizes_px[name]
        lines.append(f"  {name}: {file}, {width} x {height} px")
    written = [path for path in outputs if path is not None]
    for path in written:
        lines.append(f"would {'replace' if path.exists() else 'write'} {path}")
    record = {
        "cameras": {name: str(file) for name, file in files.items()},
        "would_write": [str(path) for path in written],
        "written": [],
    }
    return Outcome("\n".join(lines), record)
