"""Rims as the caller's values: their pieces, their table, and the matches with them."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.intrinsics import distort_pixels
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.rims.circles import (
    ENDS,
    MIDDLE,
    ON_ARC,
    Chords,
    Circles,
    off_circles,
    points_on_circles,
)
from trinoc.match.rims.explained_tracks import count_tracks, tracks_beside_rims, with_rows
from trinoc.match.rims.rims import Rims
from trinoc.match.tracks.line_fit import cut_fragments, line_end_positions, view_ends_line
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.vectors import add_error_of_ends, complete_axes, cross_3d

# numerical: a whole turn, in rad.
ROUND = 2 * np.pi


class Arcs(NamedTuple):
    """What chords cover of a circle, by angle: from begin to end, begin in [0, 2 pi)."""

    begin: Float[np.ndarray, "n"]
    end: Float[np.ndarray, "n"]

    def hold(self, angle: Float[np.ndarray, "a"]) -> Bool[np.ndarray, "a n"]:
        """Whether each covers each angle."""
        return (angle[:, None] - self.begin) % ROUND < self.end - self.begin


class CirclePieces(NamedTuple):
    """begin, end : (p,) angles. chord : (p, v) that shows each in each view, -1 for none."""

    begin: Float[np.ndarray, "p"]
    end: Float[np.ndarray, "p"]
    chord: Int[np.ndarray, "p v"]


def cover_circle(around_mm: Float[np.ndarray, "n 5 3"], circle: Circles) -> Arcs:
    """What chords cover of one circle; `around_mm` are its points next to their places."""
    across = complete_axes(circle.normal)[0]
    out = (around_mm - circle.centre_mm[0]) @ across.T
    angle = np.arctan2(out[..., 1], out[..., 0])
    middle = angle[:, MIDDLE]
    apart = (angle[:, ENDS] - middle[:, None] + np.pi) % ROUND - np.pi
    begin, end = middle + apart.min(axis=1), middle + apart.max(axis=1)
    turns = np.floor(begin / ROUND) * ROUND
    return Arcs(begin - turns, end - turns)


def share_of_two_views(arcs: Arcs, view: Int[np.ndarray, "n"], views: int) -> float:
    """Share of the circle that chords of two views or more show."""
    border = np.unique(np.concatenate([arcs.begin, arcs.end]) % ROUND)
    if len(border) == 0:
        return 0.0
    width = np.diff(border, append=border[0] + ROUND)
    held = arcs.hold(border + width / 2) @ (view[:, None] == np.arange(views))
    return float(width[held.sum(axis=1) >= 2].sum() / ROUND)


def cut_pieces(
    arcs: Arcs, view: Int[np.ndarray, "n"], views: int, least_rad: float
) -> CirclePieces:
    """The parts that one set of chords shows each, of two views or more; of several chords of a
    view the one that reaches furthest."""
    border = np.unique(np.concatenate([arcs.begin, arcs.end]) % ROUND)
    width = np.diff(border, append=border[0] + ROUND)
    held = arcs.hold(border + width / 2)
    reach = np.where(held, arcs.end - arcs.begin, 0.0)
    chord = np.full((len(border), views), -1)
    for number in range(views):
        own = np.flatnonzero(view == number)
        if len(own):
            best = own[reach[:, own].argmax(axis=1)]
            chord[:, number] = np.where(reach[np.arange(len(border)), best] > 0, best, -1)
    # Neighbours that the same chords show are one.
    begin, end, rows = [], [], []
    for row, (start, step) in enumerate(zip(border, width, strict=True)):
        if len(rows) > 0 and (chord[rows[-1]] == chord[row]).all():
            end[-1] = start + step
        else:
            begin.append(start)
            end.append(start + step)
            rows.append(row)
    found = CirclePieces(np.array(begin), np.array(end), chord[rows])
    kept = ((found.chord >= 0).sum(axis=1) >= 2) & (found.end - found.begin > least_rad)
    return CirclePieces(*(column[kept] for column in found))


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
        back = np.full(len(seen.frames[0].exclusion_reasons[view]), -1)
        back[seen.order[view]] = np.arange(len(seen.order[view]))
        own[:, view] = np.where(index[:, at] >= 0, back[np.maximum(index[:, at], 0)], -1)
    here = view_ends_line(seen, own, lines_mm)
    interval = np.clip(line_end_positions(seen, own, lines_mm), 0.0, 1.0)
    parts, covariance = cut_fragments(seen, own, interval, here)
    fragments, spread = np.full(parts.shape, np.nan), np.full(covariance.shape, np.nan)
    for view, at in enumerate(column):
        on = np.flatnonzero(index[:, at] >= 0)
        way = parts[on, view, 1] - parts[on, view, 0]
        way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        right = np.stack([-way[:, 1], way[:, 0]], axis=1)
        bow = _bows(chords, circles, chord[on, at])
        own_spread = covariance[on, view]
        add_error_of_ends(own_spread, np.repeat((bow[:, None] * right)[:, None], 2, axis=1))
        spread[on, at] = own_spread
        lens = seen.frames[0].cameras.intrinsics[view]
        fragments[on, at] = distort_pixels(lens, parts[on, view])
    return fragments, spread


def _bows(chords: Chords, circles: Circles, row: Int[np.ndarray, "p"]) -> Float[np.ndarray, "p"]:
    """How far chords are off their arcs between the places where they cross them, px; each chord
    is that of the circle which it is nearest to."""
    if len(row) == 0:
        return np.zeros(0)
    unique, back = np.unique(row, return_inverse=True)
    px = off_circles(take_rows(chords, unique), circles).px
    nearest = np.abs(px[..., ON_ARC]).max(axis=2).argmin(axis=0)
    px = px[nearest, np.arange(len(unique))]
    return np.abs(px[:, MIDDLE] - px[:, ON_ARC].mean(axis=1))[back]


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


class RimChoice(NamedTuple):
    """rims : those put out. ambiguous : how many were not, as one of two views has another."""

    rims: list[FittedRim]
    ambiguous: int


class RimPieces(NamedTuple):
    """Pieces of rims as rows of matches. chord : (p, v), -1 for none. posterior : of its rim."""

    chord: Int[np.ndarray, "p v"]
    lines_mm: Float[np.ndarray, "p 2 3"]
    covariance_mm2: Float[np.ndarray, "p 6 6"]
    posterior: Float[np.ndarray, "p"]


def build_rims(
    matches: Matches,
    seen: MatchInput,
    chords: Chords,
    chosen: RimChoice,
    mm_per_px: float,
    tuning: RimTuning,
) -> Rims:
    """The rims put out, with their chords in the order of views and segments."""
    views, found = len(matches.views), chosen.rims
    parts = [_pieces(rim, chords, views, mm_per_px, tuning) for rim in found]
    empty = RimPieces(
        np.zeros((0, views), np.int64), np.zeros((0, 2, 3)), np.zeros((0, 6, 6)), np.zeros(0)
    )
    pieces = concatenate_rows([empty, *parts])
    rim = np.full(len(chords.view), -1)
    for number, each in enumerate(found):
        rim[each.own] = number
    circles = concatenate_rows([_NO_CIRCLES, *(each.circle for each in found)])
    tracks = tracks_beside_rims(matches, chords, circles, rim, mm_per_px, tuning)
    own = np.flatnonzero(rim >= 0)
    own = own[np.lexsort((chords.segment[own], chords.view[own], rim[own]))]
    counts = count_tracks(len(found), matches, tracks, len(pieces.chord))
    counts["rims of two views that fit another as well"] = chosen.ambiguous
    rows = _match_rows(matches.views, seen, chords, circles, pieces)
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


# numerical: no circles.
_NO_CIRCLES = Circles(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def _pieces(
    rim: FittedRim, chords: Chords, views: int, mm_per_px: float, tuning: RimTuning
) -> RimPieces:
    """Pieces of one rim, as lines in space with their covariance."""
    circle = rim.circle
    radius = circle.radius_mm[0]
    least = tuning.end_px * mm_per_px / radius
    found = cut_pieces(rim.arcs, chords.view[rim.own], views, least)
    angle = np.stack([found.begin, found.end], axis=1)
    ends = points_on_circles(circle, angle.reshape(1, -1)).reshape(-1, 2, 3)
    out = (ends - circle.centre_mm[0]) / radius
    slope = np.zeros((len(ends), 2, 3, 6))
    slope[..., :3] = np.eye(3)
    # As the normal turns toward one axis, what lies along that axis sinks.
    across = out @ complete_axes(circle.normal)[0].T
    slope[..., 3:5] = -radius * across[:, :, None] * circle.normal[0][:, None]
    slope[..., 5] = out
    slope = slope.reshape(-1, 6, 6)
    covariance = slope @ rim.covariance @ slope.mT
    add_error_of_ends(covariance, (tuning.end_px * mm_per_px) * cross_3d(circle.normal, out))
    chord = np.where(found.chord >= 0, rim.own[np.maximum(found.chord, 0)], -1)
    return RimPieces(chord, ends, covariance, np.full(len(chord), tuning.posterior))


def _public(rim: FittedRim) -> Float[np.ndarray, "7 7"]:
    """Covariance of centre, normal and radius."""
    slope = np.zeros((7, 6))
    slope[:3, :3], slope[6, 5] = np.eye(3), 1.0
    slope[3:6, 3:5] = complete_axes(rim.circle.normal)[0].T
    return slope @ rim.covariance @ slope.T


def _match_rows(
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
