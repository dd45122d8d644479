"""`trinoc segments`: the straight edges of one picture; options of commands that find segments."""

import inspect
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import trinoc
from trinoc.cli.command import Job, Outcome, UsageError
from trinoc.cli.options import Settings
from trinoc.cli.settings import parse_number, parse_truth, read_settings


def segments(
    image: Path,
    /,
    *,
    tolerance_px: float = 1.6,
    false_alarms: float = 1.0,
    least_contrast: float = 7.0,
    arcs: bool = False,
    response: Literal["linear", "srgb"] | float = "linear",
    out: Path = Path("segments.npz"),
    job: Job,
) -> Outcome:
    """Detect the line segments of an image (Nevatia and Babu).

    Parameters
    ----------
    image : IMG
        The image: PNG, TIFF or JPEG, 8 or 16 bit, grey or colour.
    tolerance_px
        Largest deviation of an edge from a straight line.
    false_alarms
        Expected number of false segments in an image of noise.
    least_contrast
        Smallest contrast of an edge, in grey levels of 0 to 255.
    arcs
        Keep chords of arcs, such as rims of cylinders. They show more of the scene and are less
        accurate.
    response : linear|srgb|NUMBER
        Response of the camera: linear, srgb (nearly all cameras that are not industrial ones), or a
        number between, 0 for linear and 1 for sRGB. It corrects the position of blurred edges.
    out
        File of the segments.
    """
    settings: dict[str, Any] = {
        "tolerance_px": tolerance_px,
        "false_alarms": false_alarms,
        "least_contrast": least_contrast,
        "arcs": arcs,
        "response": response,
    }
    _expect_find(settings, lambda name: f"--{name.replace('_', '-')}")

    from trinoc.segments.nothing_found import why_nothing, why_short

    job.expect(trinoc.Segments, out)
    picture = trinoc.io.read_image(image)
    result = trinoc.find_segments(picture, **settings)
    trinoc.save(result, out, overwrite=True)
    count = len(result)
    median_px = float(sorted(result.length_px)[count // 2]) if count else 0.0
    nothing = None if count else why_nothing(picture, least_contrast=least_contrast)
    short = why_short(picture) if count else None
    record = {
        "segments": count,
        "median_length_px": median_px,
        "why_nothing": nothing,
        "why_short": short,
    }
    lines = [f"{count} segments, median length {median_px:.1f} px", nothing, short]
    return Outcome("\n".join(filter(None, lines)), record, written=(out,))


# The settings of `find_segments`, which `trinoc segments` has as options.
FIND: Mapping[str, Callable[[str], Any]] = {
    "tolerance_px": parse_number,
    "false_alarms": parse_number,
    "least_contrast": parse_number,
    "arcs": parse_truth,
    "response": lambda text: text if text in ("linear", "srgb") else parse_number(text),
}


def find_settings(find: Settings) -> dict[str, Any]:
    """All settings of `find_segments`: those of --find, and the defaults. Raises UsageError."""
    defaults = {name: inspect.signature(segments).parameters[name].default for name in FIND}
    settings = {**defaults, **read_settings("--find", find, FIND)}
    _expect_find(settings, lambda name: f"--find {name}")
    return settings


def _expect_find(settings: Mapping[str, Any], spell: Callable[[str], str]) -> None:
    """Raise UsageError for invalid settings of the segment detection.

    spell : function that returns the name of a setting as the user types it.
    """
    for name in ("tolerance_px", "false_alarms"):
        if not settings[name] > 0:
            raise UsageError(f"{spell(name)} is {settings[name]:g}, but must be positive.")
    least_contrast = settings["least_contrast"]
    if not least_contrast >= 0:
        raise UsageError(
            f"{spell('least_contrast')} is {least_contrast:g}, but must not be negative."
        )
    response = settings["response"]
    if not isinstance(response, str) and not -1 <= response <= 2:
        raise UsageError(
            f"{spell('response')} is {response:g}, but must be linear, srgb or a number from -1 "
            "to 2."
        )


# Not None: an option that may be a pair or nothing would take pictures that follow it.
ANYWHERE = (0.0, math.inf)


def depth_range(depths_mm: tuple[float, float]) -> tuple[float, float] | None:
    """Range of --depth-range-mm in mm; None if all depths are allowed. Raises UsageError."""
    smallest_mm, largest_mm = depths_mm
    if not 0 <= smallest_mm < largest_mm:
        raise UsageError(
            f"--depth-range-mm {smallest_mm:g} {largest_mm:g} contains no depth: give the "
            "smallest, then the largest depth, in mm."
        )
    return None if depths_mm == ANYWHERE else depths_mm
