"""Figures and tables of segments and matches: images, counts, reasons and tracks."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.geometry.line_lengths import LineSigmas, line_sigmas
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.answers import MATCHED
from trinoc.match.tracks.matches import (
    BINOCULAR,
    EVEN_POSTERIOR,
    TRINOCULAR,
    Matches,
)
from trinoc.report.numbers import in_words, with_decimals, with_sigma
from trinoc.report.pictures import PagePicture, Window
from trinoc.report.report_table import ReportTable
from trinoc.report.space_content import PALETTE, distinct_neighbours

# In 1/512 of the image's width: height of a label, width of a letter, distance from its line.
HEIGHT, LETTER, AWAY = 15.0, 9.0, 12.0
# Positions of a label along its line, the best first.
PLACES = (0.5, 0.3, 0.7, 0.15, 0.85)


class PlacedLabel(NamedTuple):
    """A label and the position of its middle, in pixels of the image."""

    u: float
    v: float
    text: str


def place_labels(
    texts: Sequence[str], lines_px: Float[np.ndarray, "n 2 2"], window: Window
) -> list[PlacedLabel]:
    """Place labels next to their lines (n, 2 ends, 2) px, so that no two labels overlap.

    A label without a free position is omitted.
    """
    occupied_boxes: list[tuple[float, float, float, float]] = []
    labels = []
    for text, (first, second) in zip(texts, lines_px, strict=True):
        along = second - first
        length = float(np.hypot(*along))
        across = np.array([-along[1], along[0]]) / (length + 1e-9) * AWAY * window.unit
        half_size = np.array([len(text) * LETTER, HEIGHT]) * window.unit / 2
        for share, side in ((share, side) for share in PLACES for side in (1, -1)):
            middle = first + share * along + side * across
            low, high = middle - half_size, middle + half_size
            box = (*low.tolist(), *high.tolist())
            if _inside(box, window) and not any(_overlap(box, other) for other in occupied_boxes):
                occupied_boxes.append(box)
                labels.append(PlacedLabel(float(middle[0]), float(middle[1]), text))
                break
    return labels


def _inside(box: tuple[float, float, float, float], window: Window) -> bool:
    left, top, right, bottom = box
    return (
        left >= window.left
        and top >= window.top
        and right <= window.left + window.width
        and bottom <= window.top + window.height
    )


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


NUMBERED = 14


class Stroke(NamedTuple):
    """Segment or fragment that is drawn on an image.

    Attributes
    ----------
    u1, v1, u2, v2 : float
        Ends, px.
    track : int
        Index of its track; -1 if it is on no track.
    colour : str
        Colour; "" for the default.
    description : str
        Text that appears when the reader points at the stroke.
    matched : bool, optional
        True if the segment was matched; None if there are no matches.
    """

    u1: float
    v1: float
    u2: float
    v2: float
    track: int
    colour: str
    description: str
    matched: bool | None = None


class SegmentsFigure(NamedTuple):
    """Figure of segments or fragments over one image.

    Attributes
    ----------
    name : str
        Name of the view.
    picture : PagePicture
        The image.
    strokes : tuple of Stroke
        Segments or fragments.
    faint : (n, 2, 2)
        Ends, px, of further segments, drawn faintly behind the strokes.
    caption : str
        Caption of the figure.
    labels : tuple of PlacedLabel
        Indices of the longest tracks.
    """

    name: str
    picture: PagePicture
    strokes: tuple[Stroke, ...]
    faint: Float[np.ndarray, "n 2 2"]
    caption: str
    labels: tuple[PlacedLabel, ...] = ()


def segments_figure(
    name: str, segments: Segments, matches: Matches | None, picture: PagePicture
) -> SegmentsFigure:
    """Figure of all segments of one view.

    Each segment is described by its longest track, or by the reason why it is on none.
    """
    reasons = None if matches is None else matches.reasons.get(name)
    track_of = {} if matches is None else _longest_tracks(matches, name)
    strokes = []
    for row, ((u1, v1), (u2, v2)) in enumerate(np.asarray(segments.endpoints_px).tolist()):
        description = f"segment {row} of {name}: {np.hypot(u2 - u1, v2 - v1):.1f} px"
        contrast = float(segments.contrast[row])
        if np.isfinite(contrast):
            description += f", step of {contrast:.0f} grey levels"
        if reasons is not None:
            description += f", {in_words(str(reasons[row]))}"
        track = track_of.get(row, -1)
        description += f" (track {track})" if track >= 0 else ""
        matched = None if matches is None else track >= 0
        strokes.append(Stroke(u1, v1, u2, v2, track, "", description, matched))
    length = float(np.sum(segments.length_px))
    caption = f"{len(segments):,} segments, {length:,.0f} px in all"
    if matches is not None:
        caption = f"{len(segments):,} segments, {len(track_of):,} matched"
    return SegmentsFigure(name, picture, tuple(strokes), np.zeros((0, 2, 2)), caption)


def _longest_tracks(matches: Matches, name: str) -> dict[int, int]:
    """Index of the longest track of each matched segment of a view, by segment index."""
    lengths = np.linalg.norm(np.diff(np.asarray(matches.lines_mm), axis=1)[:, 0], axis=-1)
    column = np.asarray(matches.index)[:, matches.views.index(name)]
    order = [track for track in np.argsort(lengths, kind="stable").tolist() if column[track] >= 0]
    return {int(column[track]): track for track in order}


def tracks_figures(
    stage: str,
    matches: Matches,
    segments: Mapping[str, Segments],
    pictures: Mapping[str, PagePicture],
    colours: list[str],
    sigmas: LineSigmas,
) -> tuple[SegmentsFigure, ...]:
    """Figure of each view with the tracks of one stage ("trinocular" or "binocular").

    Segments on none of these tracks are drawn faintly. Empty if the stage has no track.

    segments : segments by view. pictures : images by view. colours : colour of each track.
    sigmas : lengths of the tracks' 3-D lines, with their sigmas.
    """
    tracks = np.flatnonzero(np.asarray(matches.stage) == stage)
    if len(tracks) == 0:
        return ()
    longest_tracks = tracks[np.argsort(-sigmas.length_mm[tracks], kind="stable")][:NUMBERED]
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
            description = f"track {track}: segment {segment} of {name}, {length} mm"
            strokes.append(Stroke(u1, v1, u2, v2, track, colours[track], description))
        ends = np.asarray(segments[name].endpoints_px) if name in segments else np.zeros((0, 2, 2))
        faint = ends[~np.isin(np.arange(len(ends)), matches.index[tracks, view])]
        picture, caption = pictures[name], f"{len(strokes):,} tracks"
        by_track = {stroke.track: stroke for stroke in strokes}
        labelled = [(str(t), by_track[t]) for t in longest_tracks.tolist() if t in by_track]
        labels = place_labels(
            [text for text, _ in labelled],
            np.array([((s.u1, s.v1), (s.u2, s.v2)) for _, s in labelled]).reshape(-1, 2, 2),
            picture.window,
        )
        figures.append(SegmentsFigure(name, picture, tuple(strokes), faint, caption, tuple(labels)))
    return tuple(figures)


TABLE_ROWS = 300


class MatchesPart(NamedTuple):
    """Section of the report with segments and, if there are any, matches.

    Attributes
    ----------
    segments : tuple of SegmentsFigure
        All segments of each view.
    trinocular, binocular : tuple of SegmentsFigure
        Tracks in three or more views, and tracks in two views.
    trinocular_count, binocular_count : int
        Numbers of these tracks.
    pairs_of_views : tuple of (text, count)
        Number of binocular tracks of each pair of views.
    counts : ReportTable, optional
        Numbers of candidates and tracks after each step of the matching.
    reasons : ReportTable, optional
        Numbers of segments by the reason why they are matched or not.
    tracks : ReportTable, optional
        The longest tracks.
    """

    segments: tuple[SegmentsFigure, ...]
    trinocular: tuple[SegmentsFigure, ...] = ()
    binocular: tuple[SegmentsFigure, ...] = ()
    trinocular_count: int = 0
    binocular_count: int = 0
    pairs_of_views: tuple[tuple[str, int], ...] = ()
    counts: ReportTable | None = None
    reasons: ReportTable | None = None
    tracks: ReportTable | None = None


def reasons_by_view(matches: Matches) -> dict[str, dict[str, int]]:
    """Number of segments of each view by their reason, "matched" first, then by frequency.

    Reasons that differ only in a number, such as "ambiguous with 3", are counted together.
    """
    counts: dict[str, dict[str, int]] = {}
    for view in matches.views:
        for reason in np.asarray(matches.reasons[view], dtype=str).tolist():
            label = in_words(re.sub(r"\d+", "others", reason))
            counts.setdefault(label, dict.fromkeys(matches.views, 0))[view] += 1
    order = sorted(
        counts, key=lambda label: (label != MATCHED, -sum(counts[label].values()), label)
    )
    return {label: counts[label] for label in order}


def reasons_table(matches: Matches) -> ReportTable:
    """Table of the number of segments by reason, for each view and in total."""
    rows = [
        [label, *map(str, counts.values())] for label, counts in reasons_by_view(matches).items()
    ]
    totals = [str(len(matches.reasons[view])) for view in matches.views]
    return ReportTable(
        ("reason", *matches.views),
        [*rows, ["all segments", *totals]],
        caption="What became of every segment",
        row_attributes=[*({} for _ in rows), {"class": "total"}],
    )


def counts_table(matches: Matches) -> ReportTable:
    """Table of the numbers of candidates and tracks that each step of the matching kept and
    rejected.

    The reasons of the segments are omitted.
    """
    rows = [
        [in_words(name), f"{count:,}"]
        for name, count in matches.counts.items()
        if not name.startswith("segments ")
    ]
    return ReportTable(("matching", "count"), rows, "What each step produced and rejected")


def matches_part(
    views: tuple[str, ...],
    segments: Mapping[str, Segments],
    matches: Matches | None,
    pictures: Mapping[str, PagePicture],
) -> MatchesPart:
    """Section with the segments and, if `matches` is given, the matches.

    views : names of the views. segments, pictures : by view.
    """
    figures = tuple(
        segments_figure(name, segments[name], matches, pictures[name])
        for name in views
        if name in segments
    )
    if matches is None:
        return MatchesPart(figures)
    colours = track_colours(matches)
    sigmas = line_sigmas(matches.lines_mm, matches.covariance_mm2)
    stage = np.asarray(matches.stage)
    return MatchesPart(
        figures,
        tracks_figures(TRINOCULAR, matches, segments, pictures, colours, sigmas),
        tracks_figures(BINOCULAR, matches, segments, pictures, colours, sigmas),
        int((stage == TRINOCULAR).sum()),
        int((stage == BINOCULAR).sum()),
        _pairs_of_views(matches),
        counts_table(matches),
        reasons_table(matches),
        tracks_table(matches),
    )


def track_colours(matches: Matches) -> list[str]:
    """Colour of each track, such that tracks that are near each other in an image differ."""
    middles_px = np.asarray(matches.fragments_px).mean(axis=2)
    return [PALETTE[colour] for colour in distinct_neighbours(middles_px).tolist()]


def _pairs_of_views(matches: Matches) -> tuple[tuple[str, int], ...]:
    """Number of binocular tracks of each pair of views, with the names of the pair as text."""
    is_seen = np.asarray(matches.index)[np.asarray(matches.stage) == BINOCULAR] >= 0
    views = matches.views
    return tuple(
        (f"{views[a]} and {views[b]}", int((is_seen[:, a] & is_seen[:, b]).sum()))
        for a in range(len(views))
        for b in range(a + 1, len(views))
    )


def tracks_table(matches: Matches) -> ReportTable:
    """Table of the longest tracks: views, segments, length, sigma and posterior of each."""
    sigmas, colours = line_sigmas(matches.lines_mm, matches.covariance_mm2), track_colours(matches)
    order = np.argsort(-sigmas.length_mm, kind="stable")[:TABLE_ROWS].tolist()
    none = np.zeros(len(matches))
    moves = none if matches.viewpoint_dependent is None else matches.viewpoint_dependent
    silhouette = matches.marks.get("silhouette", none)
    rows = [
        [
            str(track),
            str(matches.stage[track])
            + (", moves" if moves[track] else "")
            + (", outline of a round body" if silhouette[track] > EVEN_POSTERIOR else ""),
            *("\N{EN DASH}" if i < 0 else str(i) for i in matches.index[track].tolist()),
            with_sigma(float(sigmas.length_mm[track]), float(sigmas.length_sigma_mm[track])),
            with_decimals(float(sigmas.across_sigma_mm[track]), 3),
            with_decimals(float(matches.posterior[track]), 3),
            with_decimals(float(matches.rival_posterior[track]), 3),
        ]
        for track in order
    ]
    head = ("track", "seen", *(f"segment of {view}" for view in matches.views), "length (mm)")
    return ReportTable(
        (*head, "sigma across (mm)", "posterior", "runner-up"),
        rows,
        look="tracks",
        row_attributes=[
            {"tabindex": "0", "data-track": str(track), "style": f"--swatch:{colours[track]}"}
            for track in order
        ],
    )


def share_matched(matches: Matches) -> float:
    """Share of all segments that are on a track, 0 to 1; NaN without segments."""
    of_view = [np.asarray(matches.reasons[view], dtype=str) for view in matches.views]
    reasons = np.concatenate(of_view)
    return float(np.mean(np.char.startswith(reasons, MATCHED))) if len(reasons) else np.nan
