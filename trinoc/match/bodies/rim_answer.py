"""Rims as the caller's values: their table, and the matches with pieces of them."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry import distort_pixels
from trinoc.match.bodies.circles import MIDDLE, ON_ARC, Chords, Circles, off_circles, points_at
from trinoc.match.bodies.explained_tracks import counts_of, tracks_beside_rims, with_rows
from trinoc.match.bodies.rim_pieces import Arcs, pieces_of
from trinoc.match.bodies.rims import Rims
from trinoc.match.observations import MatchInput
from trinoc.match.tracks import (
    BINOCULAR,
    TRINOCULAR,
    Matches,
    ending_view,
    fragments_of,
    interval_of,
)
from trinoc.match.tuning import RimTuning
from trinoc.numerics import axes_across, cross_3d


def fragments_abreast(
    views: tuple[str, ...],
    seen: MatchInput,
    chords: Chords,
    circles: Circles,
    chord: Int[np.ndarray, "p v"],
    lines_mm: Float[np.ndarray, "p 2 3"],
    index: Int[np.ndarray, "p v"],
) -> tuple[Float[np.ndarray, "p v 2 2"], Float[np.ndarray, "p v 4 4"]]:
    """The parts of segments abreast of pieces, and their covariance: how far a segment bows off
    its arc is an error of both ends."""
    column = [views.index(name) for name in seen.names]
    own = np.full(index.shape, -1)
    for view, at in enumerate(column):
        back = np.argsort(seen.order[view])
        own[:, view] = np.where(index[:, at] >= 0, back[np.maximum(index[:, at], 0)], -1)
    here = ending_view(seen, own, lines_mm)
    interval = np.clip(interval_of(seen, own, lines_mm), 0.0, 1.0)
    parts, covariance = fragments_of(seen, own, interval, here)
    fragments, spread = np.full(parts.shape, np.nan), np.full(covariance.shape, np.nan)
    for view, at in enumerate(column):
        on = np.flatnonzero(index[:, at] >= 0)
        way = parts[on, view, 1] - parts[on, view, 0]
        way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        right = np.stack([-way[:, 1], way[:, 0]], axis=1)
        bow = _bows(chords, circles, chord[on, at])
        blocks = covariance[on, view].reshape(-1, 2, 2, 2, 2)
        more = (bow**2)[:, None, None] * right[:, :, None] * right[:, None]
        for end in (0, 1):
            blocks[:, end, :, end] += more
        spread[on, at] = blocks.reshape(-1, 4, 4)
        lens = seen.frames[0].cameras.intrinsics[view]
        fragments[on, at] = distort_pixels(lens, parts[on, view])
    return fragments, spread


def _bows(chords: Chords, circles: Circles, row: Int[np.ndarray, "p"]) -> Float[np.ndarray, "p"]:
    """How far chords are off their arcs between the places where they cross them, px; each chord
    is that of the circle which it is nearest to."""
    if len(row) == 0:
        return np.zeros(0)
    unique, back = np.unique(row, return_inverse=True)
    px = off_circles(Chords(*(part[unique] for part in chords)), circles).px
    nearest = np.abs(px[..., ON_ARC]).max(axis=2).argmin(axis=0)
    px = px[nearest, np.arange(len(unique))]
    return np.abs(px[:, MIDDLE] - px[:, ON_ARC].mean(axis=1))[back]


# Standard deviation of a piece's ends along the rim, px: where detectors cut an arc.
_END_PX = 1.0


class FittedRim(NamedTuple):
    """A rim. circle : one row. covariance : of what `move_circle` moves. own : its chords. arcs :
    what these cover of it. covered : share of it that two views show. support : length of its
    chords, px, less as they lie off it. of_two : whether two views alone have chords of it."""

    circle: Circles
    covariance: Float[np.ndarray, "6 6"]
    own: Int[np.ndarray, "k"]
    arcs: Arcs
    covered: float
    support: float
    of_two: bool


class Chosen(NamedTuple):
    """rims : those put out. ambiguous : how many were not, as one of two views has another."""

    rims: list[FittedRim]
    ambiguous: int


class RimPieces(NamedTuple):
    """Pieces of rims as rows of matches. chord : (p, v), -1 for none. posterior : of its rim."""

    chord: Int[np.ndarray, "p v"]
    lines_mm: Float[np.ndarray, "p 2 3"]
    covariance_mm2: Float[np.ndarray, "p 6 6"]
    posterior: Float[np.ndarray, "p"]


def answer_of(
    matches: Matches,
    seen: MatchInput,
    chords: Chords,
    chosen: Chosen,
    mm_per_px: float,
    tuning: RimTuning,
) -> Rims:
    """The rims put out, with their chords in the order of views and segments."""
    views, found = len(matches.views), chosen.rims
    parts = [_pieces(rim, chords, views, mm_per_px, tuning) for rim in found]
    empty = RimPieces(
        np.zeros((0, views), np.int64), np.zeros((0, 2, 3)), np.zeros((0, 6, 6)), np.zeros(0)
    )
    pieces = RimPieces(*map(np.concatenate, zip(empty, *parts, strict=True)))
    rim = np.full(len(chords.view), -1)
    for number, each in enumerate(found):
        rim[each.own] = number
    circles = Circles(
        *map(np.concatenate, zip(_NO_CIRCLES, *(r.circle for r in found), strict=True))
    )
    tracks = tracks_beside_rims(matches, chords, circles, rim, mm_per_px, tuning)
    own = np.flatnonzero(rim >= 0)
    own = own[np.lexsort((chords.segment[own], chords.view[own], rim[own]))]
    counts = counts_of(len(found), matches, tracks, len(pieces.chord))
    counts["rims of two views that fit another as well"] = chosen.ambiguous
    rows = _rows_of(matches.views, seen, chords, circles, pieces)
    joined = with_rows(matches, tracks, rows)
    return Rims(
        matches.views,
        *circles,
        np.array([_public(each) for each in found]).reshape(-1, 7, 7),
        np.array([each.covered for each in found]),
        rim[own],
        chords.view[own],
        chords.segment[own],
        dataclasses.replace(joined, counts=matches.counts | counts),
        tracks.kept,
        counts,
    )


_NO_CIRCLES = Circles(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def _pieces(
    rim: FittedRim, chords: Chords, views: int, mm_per_px: float, tuning: RimTuning
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
    posterior = np.full(len(chord), tuning.posterior_of_two if rim.of_two else tuning.posterior)
    return RimPieces(chord, ends, covariance, posterior)


def _public(rim: FittedRim) -> Float[np.ndarray, "7 7"]:
    """Covariance of centre, normal and radius."""
    slope = np.zeros((7, 6))
    slope[:3, :3], slope[6, 5] = np.eye(3), 1.0
    slope[3:6, 3:5] = axes_across(rim.circle.normal)[0].T
    return slope @ rim.covariance @ slope.T


def _rows_of(
    views: tuple[str, ...],
    seen: MatchInput,
    chords: Chords,
    circles: Circles,
    pieces: RimPieces,
) -> dict[str, np.ndarray]:
    """Pieces as rows of matches, by the names of their columns."""
    number = len(pieces.chord)
    shown = pieces.chord >= 0
    index = np.where(shown, chords.segment[np.maximum(pieces.chord, 0)], -1)
    fragments, covariance = fragments_abreast(
        views, seen, chords, circles, pieces.chord, pieces.lines_mm, index
    )
    return {
        "index": index,
        "fragments_px": fragments,
        "lines_mm": pieces.lines_mm,
        "covariance_mm2": pieces.covariance_mm2,
        "stage": np.where(shown.sum(axis=1) > 2, TRINOCULAR, BINOCULAR),
        "posterior": pieces.posterior,
        "rival_posterior": np.zeros(number),
        "fragments_covariance_px2": covariance,
        "misfit": np.zeros(number),
        "viewpoint_dependent": np.zeros(number, dtype=bool),
    }
