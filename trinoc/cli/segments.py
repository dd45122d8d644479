"""`trinoc segments`: the straight edges of one picture."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from trinoc.cli.command import Command, Outcome
from trinoc.cli.segment_options import SegmentOptions


@dataclasses.dataclass(frozen=True, kw_only=True)
class Segments(SegmentOptions, Command):
    """Find the line segments of a picture (Nevatia and Babu)."""

    picture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IMG")]
    """The picture: PNG, TIFF or JPEG, 8 or 16 bit, grey or colour."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",))] = Path("segments.npz")
    """Where the segments go."""

    def run(self, command_line: str) -> Outcome:
        """Find the segments and write them."""
        from trinoc.geometry import Segments as Found
        from trinoc.io import expect_ending, expect_place, read_image, save

        self.check()
        expect_place(self.out)
        expect_ending(self.out, Found)
        image = read_image(self.picture)
        segments = self.find(image)
        save(segments, self.out)
        count = len(segments)
        median_px = float(sorted(segments.length_px)[count // 2]) if count else 0.0
        why = "" if count else f"\n{self.why_nothing(image)}"
        text = f"{count} segments, median length {median_px:.1f} px{why}\nwritten: {self.out}"
        record = {
            "segments": count,
            "median_length_px": median_px,
            "why_nothing": why.strip() or None,
            "written": [str(self.out)],
        }
        return Outcome(text, record)
