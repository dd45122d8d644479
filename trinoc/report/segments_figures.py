"""Segments and tracks over the pictures, as figures 6 and 7 of the paper show them."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.geometry import Segments
from trinoc.match import Matches
from trinoc.report.numbers import in_words, with_sigma
from trinoc.report.pictures import PagePicture
from trinoc.report.track_sigmas import TrackSigmas

NUMBERED = 14


class Stroke(NamedTuple):
    """A segment or a fragment on a picture; `track` is -1 where it belongs to none."""

    u1: float
    v1: float
    u2: float
    v2: float
    track: int
    colour: str
    label: str
    words: str


class SegmentsFigure(NamedTuple):
    """The strokes over one picture, and the ends of segments that only stand behind them."""

    name: str
    picture: PagePicture
    strokes: tuple[Stroke, ...]
    faint: Float[np.ndarray, "n 2 2"]
    caption: str


def segments_figure(
    name: str, segments: Segments, matches: Matches | None, picture: PagePicture
) -> SegmentsFigure:
    """All segments of one view, each with the reason why it is on no track."""
    reasons = None if matches is None else matches.reasons.get(name)
    strokes = []
    for row, ((u1, v1), (u2, v2)) in enumerate(np.asarray(segments.endpoints_px).tolist()):
        words = f"segment {row}: {np.hypot(u2 - u1, v2 - v1):.1f} px"
        contrast = float(segments.contrast[row])
        if np.isfinite(contrast):
            words += f", step of {contrast:.0f} grey levels"
        if reasons is not None:
            words += f", {in_words(str(reasons[row]))}"
        strokes.append(Stroke(u1, v1, u2, v2, -1, "", "", words))
    length = float(np.sum(segments.length_px))
    return SegmentsFigure(
        name,
        picture,
        tuple(strokes),
        np.zeros((0, 2, 2)),
        f"{len(segments):,} segments, {length:,.0f} px in all",
    )


def tracks_figures(
    stage: str,
    matches: Matches,
    segments: Mapping[str, Segments],
    pictures: Mapping[str, PagePicture],
    colours: list[str],
    sigmas: TrackSigmas,
) -> tuple[SegmentsFigure, ...]:
    """The tracks of one stage in every view, over the segments that are on none of them."""
    tracks = np.flatnonzero(np.asarray(matches.stage) == stage)
    if len(tracks) == 0:
        return ()
    longest = tracks[np.argsort(-sigmas.length_mm[tracks], kind="stable")][:NUMBERED]
    numbered = set(longest.tolist())
    figures = []
    for view, name in enumerate(matches.views):
        strokes = []
        for track in tracks.tolist():
            segment = int(matches.index[track, view])
            if segment < 0:
                continue
            (u1, v1), (u2, v2) = np.asarray(matches.fragments_px[track, view]).tolist()
            length = with_sigma(
                float(sigmas.length_mm[track]), float(sigmas.length_sigma_mm[track])
            )
            words = f"track {track}: segment {segment} of {name}, {length} mm"
            label = str(track) if track in numbered else ""
            strokes.append(Stroke(u1, v1, u2, v2, track, colours[track], label, words))
        ends = np.asarray(segments[name].endpoints_px) if name in segments else np.zeros((0, 2, 2))
        faint = ends[~np.isin(np.arange(len(ends)), matches.index[tracks, view])]
        figures.append(
            SegmentsFigure(name, pictures[name], tuple(strokes), faint, f"{len(strokes):,} tracks")
        )
    return tuple(figures)
