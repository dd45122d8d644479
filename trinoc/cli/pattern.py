"""`trinoc pattern`: a sheet to print, with the layout that `trinoc calibrate` reads."""

import dataclasses
import importlib.util
from pathlib import Path
from typing import Annotated, Literal

import tyro

from trinoc.cli.command import Command, Outcome, UsageError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pattern(Command):
    """Make a sheet of circles and crossed lines: its layout, and drawings to print."""

    rows: int = 8
    """Circles from top to bottom; even, so that no line meets a circle."""

    columns: int = 8
    """Circles from left to right; even, too."""

    pitch_mm: float = 20.0
    """Distance between the centres of neighbours."""

    radius_mm: float = 6.0
    """Radius of the circles."""

    line_style: Literal["stop", "through", "white"] = "stop"
    """Where a line of an odd grid meets a circle: it stops before it, runs through it in black,
    or runs through it in white."""

    paper: Literal["a4", "letter", "a3", "a2", "a1", "a0"] = "a4"
    """Paper of the drawings."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",), metavar="FILE")] = Path("pattern.json")
    """Where the layout goes. The drawings, .svg and .pdf, go beside it."""

    def run(self, command_line: str) -> Outcome:
        """Write the files."""
        if self.out.suffix.lower() != ".json":
            raise UsageError(f"{self.out}: a layout is JSON: choose a name that ends in .json.")

        from trinoc.calib import Pattern as Sheet
        from trinoc.io import save_pattern, save_pattern_pdf, save_pattern_svg

        sheet = Sheet.cross_grid(
            rows=self.rows,
            columns=self.columns,
            pitch_mm=self.pitch_mm,
            radius_mm=self.radius_mm,
            line_style=self.line_style,
        )
        drawing, page = self.out.with_suffix(".svg"), self.out.with_suffix(".pdf")
        written = [self.out, drawing]
        # First the drawing, which fails where the sheet is larger than the paper.
        save_pattern_svg(sheet, drawing, paper=self.paper)
        save_pattern(sheet, self.out)
        notes = [
            "Print at 100 %, measure the two scale bars, and give measured over nominal length",
            "to `trinoc calibrate --print-scale`.",
        ]
        if importlib.util.find_spec("reportlab") is None:
            notes.append("No PDF, because reportlab is missing: pip install 'trinoc[print]'.")
        else:
            save_pattern_pdf(sheet, page, paper=self.paper)
            written.append(page)
        files = [str(path) for path in written]
        text = f"{len(sheet)} circles, {sheet.name}\n" + "\n".join(notes)
        record = {"name": sheet.name, "circles": len(sheet), "written": files}
        return Outcome(f"{text}\nwritten: {', '.join(files)}", record)
