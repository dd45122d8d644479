"""The package as it is written: its files, each parsed once in a process, and not before a test
asks."""

import ast
import functools
from pathlib import Path

import trinoc

ROOT = Path(trinoc.__file__).parent


@functools.cache
def parse_file(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def list_files(room: str = "") -> list[Path]:
    """The files of a room, or of the whole package."""
    return sorted((ROOT / room).rglob("*.py"))
