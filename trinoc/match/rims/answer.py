"""Rims as the caller's values: their table, and the matches with pieces of them."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.observations import MatchInput
from trinoc.match.rims.circles import Chords, Circles, points_at
from trinoc.match.rims.fragments import fragments_abreast
from trinoc.match.rims.outlines import are_outlines
from trinoc.match.rims.pieces import Arcs, pieces_of
from trinoc.match.rims.rims import Rims
from trinoc.match.tracks import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tuning import RimTuning
from trinoc.numerics import axes_across, cross_3d

# Standard deviation of a piece's ends along the rim, px: where detectors cut an arc.
_END_PX = 1.0


class Fitted(NamedTuple):
    """A rim. circle : one row. covariance : of what `moved` moves. own : its chords. arcs : what
    these cover of it. covered : share of it that two views show. support : length of its chords,
    px, less as they lie off it."""

    circle: Circles
    covariance: Float[np.ndarray, "6 6"]
    own: Int[np.ndarray, "k"]
    arcs: Arcs
    covered: float
    support: float


class RimPieces(NamedTuple):
    """Pieces of rims as rows of matches. chord : (p, v), -1 for none."""

    chord: Int[np.ndarray, "p v"]
    lines_mm: Float[np.ndarray, "p 2 3"]
    covariance_mm2: Float[np.ndarray, "p 6 6"]


def answer_of(
    matches: Matches,
    seen: MatchInput,
    chords: Chords,
    found: list[Fitted],
    mm_per_px: float,
    tuning: RimTuning,
) -> Rims:
    """The rims put out, with their chords in the order of views and segments."""
    views = len(matches.views)
    parts = [_pieces(rim, chords, views, mm_per_px, tuning) for rim in found]
    empty = RimPieces(np.zeros((0, views), np.int64), np.zeros((0, 2, 3)), np.zeros((0, 6, 6)))
    pieces = RimPieces(*map(np.concatenate, zip(empty, *parts, strict=True)))
    rim = np.full(len(chords.view), -1)
    for number, each in enumerate(found):
        rim[each.own] = number
    circles = Circles(
        *map(np.concatenate, zip(_NO_CIRCLES, *(r.circle for r in found), strict=True))
    )
    kept = np.flatnonzero(~_explained(matches, chords, rim))
    outline = are_outlines(chords, circles, mm_per_px, tuning) & (rim < 0)
    held = _on_tracks(matches, chords, outline).sum(axis=1) >= 2
    mark = np.where(held, tuning.outline_posterior, 0.0)[kept]
    if matches.silhouette is not None:
        mark = np.maximum(mark, matches.silhouette[kept])
    own = np.flatnonzero(rim >= 0)
    own = own[np.lexsort((chords.segment[own], chords.view[own], rim[own]))]
    counts = {
        "rims": len(found),
        "tracks that rims explain": len(matches) - len(kept),
        "pieces of rims": len(pieces.chord),
        "tracks of outlines below rims": int(held[kept].sum()),
    }
    joined = _with_pieces(matches, kept, seen, chords, circles, pieces, mark, tuning)
    return Rims(
        matches.views,
        *circles,
        np.array([_public(each) for each in found]).reshape(-1, 7, 7),
        np.array([each.covered for each in found]),
        rim[own],
        chords.view[own],
        chords.segment[own],
        dataclasses.replace(joined, counts=matches.counts | counts),
        kept,
        counts,
    )


_NO_CIRCLES = Circles(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def _on_tracks(
    matches: Matches, chords: Chords, which: Bool[np.ndarray, "n"]
) -> Bool[np.ndarray, "t v"]:
    """Whether the segment of each view on each track is one of these."""
    found = np.zeros(matches.index.shape, dtype=bool)
    for view in range(matches.index.shape[1]):
        own = chords.segment[which & (chords.view == view)]
        found[:, view] = np.isin(matches.index[:, view], own)
    return found


def _explained(
    matches: Matches, chords: Chords, rim: Int[np.ndarray, "n"]
) -> Bool[np.ndarray, "t"]:
    """Tracks of which two segments are chords of one rim, or one of two is a rim's chord."""
    number = np.zeros(len(matches), dtype=np.int64)
    for each in range(rim.max(initial=-1) + 1):
        number = np.maximum(number, _on_tracks(matches, chords, rim == each).sum(axis=1))
    return number > np.where((matches.index >= 0).sum(axis=1) > 2, 1, 0)


def _pieces(
    rim: Fitted, chords: Chords, views: int, mm_per_px: float, tuning: RimTuning
) -> RimPieces:
    """Pieces of one rim, as lines in space with their covariance."""
    circle = rim.circle
    radius = circle.radius_mm[0]
    least = tuning.shortest_piece_px * mm_per_px / radius
    found = pieces_of(rim.arcs, chords.view[rim.own], views, least, tuning)
    angle = np.stack([found.begin, found.end], axis=1)
    ends = points_at(circle, angle.reshape(1, -1)).reshape(-1, 2, 3)
    out = (ends - circle.centre_mm[0]) / radius
    slope = np.zeros((len(ends), 2, 3, 6))
    slope[..., :3] = np.eye(3)
    # As the normal turns toward one axis, what lies along that axis sinks.
    across = out @ axes_across(circle.normal)[0].T
    slope[..., 3:5] = -radius * across[:, :, None] * circle.normal[0][:, None]
    slope[..., 5] = out
    slope = slope.reshape(-1, 6, 6)
    covariance = slope @ rim.covariance @ slope.mT
    along = (_END_PX * mm_per_px) * cross_3d(circle.normal, out)
    for end in (0, 1):
        part = slice(3 * end, 3 * end + 3)
        covariance[:, part, part] += along[:, end, :, None] * along[:, end, None]
    chord = np.where(found.chord >= 0, rim.own[np.maximum(found.chord, 0)], -1)
    return RimPieces(chord, ends, covariance)


def _public(rim: Fitted) -> Float[np.ndarray, "7 7"]:
    """Covariance of centre, normal and radius."""
    slope = np.zeros((7, 6))
    slope[:3, :3], slope[6, 5] = np.eye(3), 1.0
    slope[3:6, 3:5] = axes_across(rim.circle.normal)[0].T
    return slope @ rim.covariance @ slope.T


def _with_pieces(
    matches: Matches,
    kept: Int[np.ndarray, "k"],
    seen: MatchInput,
    chords: Chords,
    circles: Circles,
    pieces: RimPieces,
    silhouette: Float[np.ndarray, "k"],
    tuning: RimTuning,
) -> Matches:
    """The tracks that are kept, and after them pieces of rims."""
    number = len(pieces.chord)
    shown = pieces.chord >= 0
    index = np.where(shown, chords.segment[np.maximum(pieces.chord, 0)], -1)
    fragments, covariance = fragments_abreast(
        matches.views, seen, chords, circles, pieces.chord, pieces.lines_mm, index
    )
    new: dict[str, Any] = {
        "index": index,
        "fragments_px": fragments,
        "lines_mm": pieces.lines_mm,
        "covariance_mm2": pieces.covariance_mm2,
        "stage": np.where(shown.sum(axis=1) > 2, TRINOCULAR, BINOCULAR),
        "posterior": np.full(number, tuning.posterior),
        "rival_posterior": np.zeros(number),
        "fragments_covariance_px2": covariance,
        "misfit": np.zeros(number),
        "viewpoint_dependent": np.zeros(number, dtype=bool),
        "guided": np.zeros(shown.shape, dtype=bool),
        "measure": np.full(shown.shape, ""),
        "silhouette": np.zeros(number),
    }
    rows = {
        name: np.concatenate([np.asarray(before)[kept], new[name]])
        for name in new
        if (before := getattr(matches, name)) is not None
    }
    rows["silhouette"] = np.concatenate([silhouette, new["silhouette"]])
    words = {name: column.copy() for name, column in matches.reasons.items()}
    for view, name in enumerate(matches.views):
        words[name][index[shown[:, view], view]] = "matched"
    return dataclasses.replace(matches, **rows, reasons=words)
