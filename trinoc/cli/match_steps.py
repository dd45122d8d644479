"""What `trinoc match` is asked to find, and the steps that find it."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import tyro

from trinoc.cli.progress import LOGGER
from trinoc.cli.segment_options import SegmentOptions

if TYPE_CHECKING:
    import numpy as np

    from trinoc.geometry import Rig, Segments
    from trinoc.match import Cylinders, Matches, Rims, Shadows

# Not None: an option that may be a pair or nothing would take pictures that follow it.
ANYWHERE = (0.0, math.inf)


@dataclasses.dataclass(frozen=True, kw_only=True)
class MatchOptions(SegmentOptions):
    """Options of the steps from segments to tracks and bodies."""

    depth_range_mm: Annotated[
        tuple[float, float],
        tyro.conf.arg(metavar="NEAR FAR", help_behavior_hint="(default: anywhere before them)"),
    ] = ANYWHERE
    """Least and greatest depth of lines before every camera that sees them."""

    guided: bool = False
    """Ask every picture again where matched lines must be: finds faint edges, takes longer."""

    measure: Literal["segments", "pixels"] = "segments"
    """What places the lines: their segments, or the grey levels of all their views, which are more
    exact and take longer."""

    rims: bool = False
    """Also find the circular rims of round bodies among the chords of arcs, which are no segments
    otherwise, and add pieces of them to the tracks."""

    rims_out: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")
    ] = None
    """As --rims, and write the circles with their covariance here (npz)."""

    cylinders: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")
    ] = None
    """Also find right circular cylinders by their outlines, and write them here (npz). Tracks that
    hold an outline are marked."""

    shadows: bool = False
    """Also say how likely each track is the boundary of a cast shadow, and where the lamp is."""


class Found(NamedTuple):
    """segments, of each view, are those that the matches number; the rest where asked for."""

    segments: "Mapping[str, Segments]"
    matches: "Matches"
    cylinders: "Cylinders | None"
    rims: "Rims | None"
    shadows: "Shadows | None"


def found_in(
    options: MatchOptions,
    images: "Mapping[str, np.ndarray]",
    segments: "Mapping[str, Segments]",
    rig: "Rig",
) -> Found:
    """The steps asked for, one after the other."""
    from trinoc.match import match_segments

    depths = None if options.depth_range_mm == ANYWHERE else options.depth_range_mm
    matches = match_segments(segments, rig, depth_range_mm=depths)
    if options.guided:
        from trinoc.match import guide_matches

        LOGGER.info("asking the pictures again along %d lines", len(matches))
        guided = guide_matches(matches, segments, rig, images)
        segments, matches = guided.segments, guided.matches
    if options.measure == "pixels":
        from trinoc.match import measure_lines

        LOGGER.info("measuring %d lines in the pictures", len(matches))
        matches = measure_lines(matches, segments, rig, images, response=options.response)
    cylinders, rims, shadows = None, None, None
    if options.cylinders is not None:
        from trinoc.match import find_cylinders

        cylinders = find_cylinders(matches, segments, rig)
        matches = cylinders.marked(matches)
    if options.rims or options.rims_out is not None:
        from trinoc.match import add_rims, find_rims

        LOGGER.info("looking for rims")
        with_arcs = dataclasses.replace(options, arcs=True)
        chords = {name: with_arcs.find(image) for name, image in images.items()}
        rims = find_rims(match_segments(chords, rig, depth_range_mm=depths), chords, rig)
        joined = add_rims(matches, segments, rims, chords, rig)
        segments, matches = joined.segments, joined.matches
        if cylinders is not None:
            cylinders = cylinders.of_tracks(joined.kept, len(matches))
    if options.shadows:
        from trinoc.match import find_shadows

        LOGGER.info("looking for the lamp of %d lines", len(matches))
        shadows = find_shadows(matches, segments, rig)
        matches = shadows.marked(matches)
    return Found(segments, matches, cylinders, rims, shadows)
