"""`trinoc pattern`: a sheet to print, with the layout that `trinoc calibrate` reads."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from trinoc.cli.command import Command, Outcome


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pattern(Command):
    """Make a sheet of circles and crossed lines: its layout, and drawings to print."""

    rows: int = 8
    """Circles from top to bottom."""

    columns: int = 8
    """Circles from left to right."""

    pitch_mm: float = 20.0
    """Distance of the centres of neighbours."""

    radius_mm: float = 6.0
    """Radius of the circles."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",))] = Path("pattern.json")
    """Where the layout goes; the drawings go beside it."""

    def run(self, command_line: str) -> Outcome:
        """Write the files."""
        raise NotImplementedError
