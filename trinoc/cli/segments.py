"""`trinoc segments`: the straight edges of one picture."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import Command, Out, Outcome, UsageError
from trinoc.cli.settings import Settings, parse_number, parse_truth, read_settings

if TYPE_CHECKING:
    import numpy as np

    from trinoc.geometry import segments


def _response(text: str) -> str | float:
    return text if text in ("linear", "srgb") else parse_number(text)


# The settings of `find_segments`, which `trinoc segments` has as options.
FIND: Mapping[str, Callable[[str], Any]] = {
    "tolerance_px": parse_number,
    "false_alarms": parse_number,
    "least_contrast": parse_number,
    "arcs": parse_truth,
    "response": _response,
}


def expect_find(settings: Mapping[str, Any], spell: Callable[[str], str]) -> None:
    """Raise UsageError for settings that no search can follow, before any work starts.

    spell : how the command line writes the name of a setting.
    """
    for name in ("tolerance_px", "false_alarms"):
        if not settings[name] > 0:
            raise UsageError(f"{spell(name)} is {settings[name]:g}, but must be positive.")
    least = settings["least_contrast"]
    if not least >= 0:
        raise UsageError(f"{spell('least_contrast')} is {least:g}, but must not be negative.")
    response = settings["response"]
    if not isinstance(response, str) and not -1 <= response <= 2:
        raise UsageError(
            f"{spell('response')} is {response:g}, but must be linear, srgb or a number from -1 "
            "to 2."
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class SegmentsCommand(Command):
    """Find the line segments of a picture (Nevatia and Babu)."""

    image: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IMG")]
    """The picture: PNG, TIFF or JPEG, 8 or 16 bit, grey or colour."""

    tolerance_px: float = 1.6
    """Coarsest deviation of an edge from a straight line."""

    false_alarms: float = 1.0
    """How many segments noise alone may bring about in a picture."""

    least_contrast: float = 7.0
    """Fainter edges are left out; in grey levels of 0 to 255."""

    arcs: bool = False
    """Keep the chords of arcs, such as the rims of cylinders: more of the scene is seen, less
    exactly."""

    response: Annotated[
        Literal["linear", "srgb"] | float, tyro.conf.arg(metavar="linear|srgb|NUMBER")
    ] = "linear"
    """How the cameras make grey levels of light: linear, srgb (nearly every camera that is not an
    industrial one), or a number, 0 for linear, 1 for sRGB. Blurred edges are placed by it."""

    out: Out = Path("segments.npz")
    """Where the segments go."""

    def run(self, command_line: str) -> Outcome:
        """Find the segments and write them."""
        from trinoc.geometry.segments import Segments
        from trinoc.io.atomic import expect_place
        from trinoc.io.images import read_image
        from trinoc.io.saving import expect_replaceable, save
        from trinoc.segments.find import find_segments
        from trinoc.segments.nothing_found import why_nothing, why_short

        settings = {name: getattr(self, name) for name in FIND}
        expect_find(settings, lambda name: f"--{name.replace('_', '-')}")
        expect_place(self.out)
        expect_replaceable(self.out, Segments, force=self.force)
        image = read_image(self.image)
        segments = find_segments(image, **settings)
        save(segments, self.out, overwrite=True)
        count = len(segments)
        median_px = float(sorted(segments.length_px)[count // 2]) if count else 0.0
        nothing = None if count else why_nothing(image, least_contrast=self.least_contrast)
        short = why_short(image) if count else None
        text = f"{count} segments, median length {median_px:.1f} px"
        record = {
            "segments": count,
            "median_length_px": median_px,
            "why_nothing": nothing,
            "why_short": short,
        }
        said = [text, *(why for why in (nothing, short) if why)]
        return Outcome("\n".join(said), record, written=(self.out,))


def usual_find() -> dict[str, Any]:
    """The settings where nothing is said."""
    return {name: getattr(SegmentsCommand, name) for name in FIND}


# Not None: an option that may be a pair or nothing would take pictures that follow it.
ANYWHERE = (0.0, math.inf)


@dataclasses.dataclass(frozen=True, kw_only=True)
class DepthOption:
    """Of commands that match."""

    depth_range_mm: Annotated[
        tuple[float, float],
        tyro.conf.arg(metavar="NEAR FAR", help_behavior_hint="(default: anywhere before them)"),
    ] = ANYWHERE
    """Least and greatest depth of lines before every camera that sees them."""

    def depths_mm(self) -> tuple[float, float] | None:
        """The range, or None where all depths are allowed. Raises UsageError."""
        near, far = self.depth_range_mm
        if not 0 <= near < far:
            raise UsageError(
                f"--depth-range-mm {near:g} {far:g} holds no depth: give the least, then the "
                "greatest, in mm."
            )
        return None if (near, far) == ANYWHERE else (near, far)


@dataclasses.dataclass(frozen=True, kw_only=True)
class FindOption:
    """Of commands that find segments on their way."""

    find: Settings = ()
    """How segments are found, by the options of `trinoc segments`: tolerance_px=1.6,
    false_alarms=1, least_contrast=7, arcs=no, response=linear."""

    def find_settings(self) -> dict[str, Any]:
        """All settings of `find_segments`. Raises UsageError."""
        settings = {**usual_find(), **read_settings("--find", self.find, FIND)}
        expect_find(settings, lambda name: f"--find {name}")
        return settings

    def find_in(self, image: "np.ndarray", **other: Any) -> "segments.Segments":
        """The segments of a picture; `other` settings count more than those that are given."""
        from trinoc.segments.find import find_segments

        return find_segments(image, **{**self.find_settings(), **other})
