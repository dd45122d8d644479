"""What `trinoc match` is asked to find."""

import dataclasses
import math
from typing import Annotated

import tyro

from trinoc.cli.segment_options import SegmentOptions
from trinoc.match import StepName

# Not None: an option that may be a pair or nothing would take pictures that follow it.
ANYWHERE = (0.0, math.inf)


@dataclasses.dataclass(frozen=True, kw_only=True)
class MatchOptions(SegmentOptions):
    """Options of the steps from segments to tracks and features."""

    depth_range_mm: Annotated[
        tuple[float, float],
        tyro.conf.arg(metavar="NEAR FAR", help_behavior_hint="(default: anywhere before them)"),
    ] = ANYWHERE
    """Least and greatest depth of lines before every camera that sees them."""

    steps: Annotated[
        tuple[StepName, ...], tyro.conf.arg(metavar="STEP...", help_behavior_hint="(default: none)")
    ] = ()
    """What to do after matching. guided: ask every picture again where matched lines must be, which
    finds faint edges. pixels: place the lines by the grey levels of all their views, which are more
    exact than segments. cylinders: find right circular cylinders by their outlines, and mark tracks
    that hold one. rims: find the circular rims of round bodies among the chords of arcs, and add
    pieces of them. shadows: say how likely each track is the boundary of a cast shadow. wireframe:
    put corners, edges and planar faces together. Cylinders, rims and a wire frame are written
    beside the matches."""
