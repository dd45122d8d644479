"""What the page shows of segments and matches: figures, counts, reasons and tracks."""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from trinoc.geometry.line_lengths import LineSigmas, line_sigmas
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import (
    BINOCULAR,
    EVEN,
    TRINOCULAR,
    Matches,
)
from trinoc.report.colours import PALETTE, distinct_neighbours
from trinoc.report.numbers import in_words, percent, with_decimals, with_sigma
from trinoc.report.pictures import PagePicture
from trinoc.report.segments_figures import SegmentsFigure, segments_figure, tracks_figures

TABLE_ROWS = 300
MATCHED = "matched"


class TrackRow(NamedTuple):
    """One line of the table of tracks."""

    track: int
    colour: str
    stage: str
    members: tuple[str, ...]
    length: str
    across: str
    posterior: str
    rival_posterior: str


class ReasonRow(NamedTuple):
    """One reason, and how many segments of each view it holds for."""

    words: str
    counts: tuple[int, ...]


class MatchesPart(NamedTuple):
    """Everything of the part on segments and matches; any list may be empty."""

    views: tuple[str, ...]
    segments: tuple[SegmentsFigure, ...]
    trinocular: tuple[SegmentsFigure, ...]
    binocular: tuple[SegmentsFigure, ...]
    trinocular_count: int
    binocular_count: int
    pairs_of_views: tuple[tuple[str, int], ...]
    counts: tuple[tuple[str, str], ...]
    reasons: tuple[ReasonRow, ...]
    totals: tuple[int, ...]
    tracks: tuple[TrackRow, ...]


def reasons_by_view(matches: Matches) -> dict[str, dict[str, int]]:
    """How many segments of each view share each reason: "matched" first, then by number.

    Reasons that differ only in a number ("ambiguous with 3") are one.
    """
    table: dict[str, dict[str, int]] = {}
    for view in matches.views:
        for reason in np.asarray(matches.reasons[view], dtype=str).tolist():
            words = in_words(re.sub(r"\d+", "others", reason))
            table.setdefault(words, dict.fromkeys(matches.views, 0))[view] += 1
    order = sorted(table, key=lambda w: (w != MATCHED, -sum(table[w].values()), w))
    return {words: table[words] for words in order}


def counts_of_steps(matches: Matches) -> tuple[tuple[str, str], ...]:
    """What each step produced and rejected, as people read it; reasons have their own table."""
    return tuple(
        (in_words(name), f"{count:,}")
        for name, count in matches.counts.items()
        if not name.startswith("segments ")
    )


def matches_part(
    views: tuple[str, ...],
    segments: Mapping[str, Segments],
    matches: Matches | None,
    pictures: Mapping[str, PagePicture],
) -> MatchesPart:
    """Figures and tables of the segments and, where there are any, of the matches."""
    found = tuple(
        segments_figure(name, segments[name], matches, pictures[name])
        for name in views
        if name in segments
    )
    if matches is None:
        return MatchesPart(views, found, (), (), 0, 0, (), (), (), (), ())
    fragments = np.asarray(matches.fragments_px)
    colours = [PALETTE[c] for c in distinct_neighbours(fragments.mean(axis=2)).tolist()]
    sigmas = line_sigmas(matches.lines_mm, matches.covariance_mm2)
    stage = np.asarray(matches.stage)
    return MatchesPart(
        views,
        found,
        tracks_figures(TRINOCULAR, matches, segments, pictures, colours, sigmas),
        tracks_figures(BINOCULAR, matches, segments, pictures, colours, sigmas),
        int((stage == TRINOCULAR).sum()),
        int((stage == BINOCULAR).sum()),
        _pairs_of_views(matches),
        counts_of_steps(matches),
        tuple(
            ReasonRow(words, tuple(counts.values()))
            for words, counts in reasons_by_view(matches).items()
        ),
        tuple(len(matches.reasons[view]) for view in matches.views),
        _track_rows(matches, colours, sigmas),
    )


def _pairs_of_views(matches: Matches) -> tuple[tuple[str, int], ...]:
    """Binocular tracks of each pair of views."""
    seen = np.asarray(matches.index)[np.asarray(matches.stage) == BINOCULAR] >= 0
    views = matches.views
    return tuple(
        (f"{views[a]} and {views[b]}", int((seen[:, a] & seen[:, b]).sum()))
        for a in range(len(views))
        for b in range(a + 1, len(views))
    )


def _track_rows(matches: Matches, colours: list[str], sigmas: LineSigmas) -> tuple[TrackRow, ...]:
    order = np.argsort(-sigmas.length_mm, kind="stable")[:TABLE_ROWS]
    viewpoint_dependent = (
        np.zeros(len(matches), dtype=bool)
        if matches.viewpoint_dependent is None
        else matches.viewpoint_dependent
    )
    none = np.zeros(len(matches))
    silhouette = matches.marks.get("silhouette", none)
    shadow = matches.marks.get("shadow", none)
    rows = []
    for track in order.tolist():
        members = tuple("" if i < 0 else str(i) for i in np.asarray(matches.index[track]).tolist())
        rows.append(
            TrackRow(
                track,
                colours[track],
                str(matches.stage[track])
                + (", moves" if viewpoint_dependent[track] else "")
                + (", outline of a cylinder" if silhouette[track] > EVEN else "")
                + (", shadow" if shadow[track] > EVEN else ""),
                members,
                with_sigma(float(sigmas.length_mm[track]), float(sigmas.length_sigma_mm[track])),
                with_decimals(float(sigmas.across_sigma_mm[track]), 3),
                with_decimals(float(matches.posterior[track]), 3),
                with_decimals(float(matches.rival_posterior[track]), 3),
            )
        )
    return tuple(rows)


def share_matched(matches: Matches) -> str:
    """The share of all segments that are on a track, as words."""
    words = np.concatenate([np.asarray(matches.reasons[view], dtype=str) for view in matches.views])
    return percent(float(np.mean(words == MATCHED))) if len(words) else percent(float("nan"))
