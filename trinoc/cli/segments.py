"""`trinoc segments`: the straight edges of one picture."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import Command, Out, Outcome, UsageError

if TYPE_CHECKING:
    import numpy as np

    from trinoc.geometry import segments


@dataclasses.dataclass(frozen=True, kw_only=True)
class SegmentOptions:
    """Options of every command that finds segments."""

    tolerance_px: float = 1.6
    """Coarsest deviation of an edge from a straight line."""

    false_alarms: float = 1.0
    """How many segments noise alone may bring about in a picture."""

    least_contrast: float = 7.0
    """Fainter edges are left out; in grey levels of 0 to 255."""

    arcs: bool = False
    """Keep the chords of arcs, such as the rims of cylinders: more of the scene is seen, less
    exactly."""

    response: Literal["linear", "srgb"] | float = "linear"
    """How the cameras make grey levels of light: linear, srgb (nearly every camera that is not an
    industrial one), or a number, 0 for linear, 1 for sRGB. Blurred edges are placed by it."""

    def check(self) -> None:
        """Raise UsageError for options that no search can follow, before any work starts."""
        for name, value in (
            ("--tolerance-px", self.tolerance_px),
            ("--false-alarms", self.false_alarms),
        ):
            if not value > 0:
                raise UsageError(f"{name} is {value:g}, but must be positive.")
        if not self.least_contrast >= 0:
            raise UsageError(
                f"--least-contrast is {self.least_contrast:g}, but must not be negative."
            )
        if not isinstance(self.response, str) and not -1 <= self.response <= 2:
            raise UsageError(
                f"--response is {self.response:g}, but must be linear, srgb or a number from -1 "
                "to 2."
            )

    def find(self, image: "np.ndarray") -> "segments.Segments":
        """The segments of a picture."""
        from trinoc.segments.find import find_segments

        return find_segments(image, **self.find_options())

    def find_options(self) -> dict[str, Any]:
        """The options as `find_segments` takes them."""
        return {
            "tolerance_px": self.tolerance_px,
            "false_alarms": self.false_alarms,
            "least_contrast": self.least_contrast,
            "arcs": self.arcs,
            "response": self.response,
        }

    def why_nothing(self, image: "np.ndarray") -> str:
        """Why `find` found no segment in a picture."""
        from trinoc.segments.nothing_found import why_nothing

        return why_nothing(image, least_contrast=self.least_contrast)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Segments(SegmentOptions, Command):
    """Find the line segments of a picture (Nevatia and Babu)."""

    picture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IMG")]
    """The picture: PNG, TIFF or JPEG, 8 or 16 bit, grey or colour."""

    out: Out = Path("segments.npz")
    """Where the segments go."""

    def run(self, command_line: str) -> Outcome:
        """Find the segments and write them."""
        from trinoc.geometry.segments import Segments as Found
        from trinoc.io.atomic import expect_place
        from trinoc.io.images import read_image
        from trinoc.io.saving import expect_ending, save

        self.check()
        expect_place(self.out)
        expect_ending(self.out, Found)
        image = read_image(self.picture)
        segments = self.find(image)
        save(segments, self.out)
        count = len(segments)
        median_px = float(sorted(segments.length_px)[count // 2]) if count else 0.0
        why = "" if count else f"\n{self.why_nothing(image)}"
        text = f"{count} segments, median length {median_px:.1f} px{why}"
        record = {
            "segments": count,
            "median_length_px": median_px,
            "why_nothing": why.strip() or None,
        }
        return Outcome(text, record, written=(self.out,))
