"""Build `Rims` from the fitted circles: their pieces, their table of chords, and the matches
with them.
"""

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
    circle_offsets,
    points_on_circles,
)
from trinoc.match.rims.explained_tracks import count_tracks, tracks_beside_rims, with_rows
from trinoc.match.rims.rims import Rims
from trinoc.match.tracks.line_fit import cut_fragments, line_end_positions, view_ends_line
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.vectors import add_error_of_ends, complete_axes, cross_3d

# numerical: 360 degrees in rad.
FULL_TURN = 2 * np.pi


class Arcs(NamedTuple):
    """Arcs of a circle by angle, rad: from begin in [0, 2 pi) to end."""

    begin: Float[np.ndarray, "n"]
    end: Float[np.ndarray, "n"]

    def hold(self, angle: Float[np.ndarray, "a"]) -> Bool[np.ndarray, "a n"]:
        """Mask (a, n) of the arcs that contain each angle."""
        return (angle[:, None] - self.begin) % FULL_TURN < self.end - self.begin


class CirclePieces(NamedTuple):
    """Pieces of a circle.

    begin, end : (p,) angles, rad.
    chord : (p, v) chord of each view, -1 if none.
    """

    begin: Float[np.ndarray, "p"]
    end: Float[np.ndarray, "p"]
    chord: Int[np.ndarray, "p v"]


def cover_circle(nearest_mm: Float[np.ndarray, "n 5 3"], circle: Circles) -> Arcs:
    """Arcs of a circle that chords cover. `nearest_mm` are the circle's points next to the
    chords' points.
    """
    axes = complete_axes(circle.normal)[0]
    radial_vector = (nearest_mm - circle.centre_mm[0]) @ axes.T
    angle = np.arctan2(radial_vector[..., 1], radial_vector[..., 0])
    middle = angle[:, MIDDLE]
    relative_end = (angle[:, ENDS] - middle[:, None] + np.pi) % FULL_TURN - np.pi
    begin, end = middle + relative_end.min(axis=1), middle + relative_end.max(axis=1)
    turns = np.floor(begin / FULL_TURN) * FULL_TURN
    return Arcs(begin - turns, end - turns)


def share_in_two_views(arcs: Arcs, view: Int[np.ndarray, "n"], views: int) -> float:
    """Share of the circle that chords of two or more views show."""
    border = np.unique(np.concatenate([arcs.begin, arcs.end]) % FULL_TURN)
    if len(border) == 0:
        return 0.0
    width = np.diff(border, append=border[0] + FULL_TURN)
    view_count = arcs.hold(border + width / 2) @ (view[:, None] == np.arange(views))
    return float(width[view_count.sum(axis=1) >= 2].sum() / FULL_TURN)


def cut_pieces(
    arcs: Arcs, view: Int[np.ndarray, "n"], views: int, smallest_rad: float
) -> CirclePieces:
    """Pieces of a circle, each shown by one set of chords in two or more views.

    If several chords of a view show a piece, the one with the longest arc is used.
    """
    border = np.unique(np.concatenate([arcs.begin, arcs.end]) % FULL_TURN)
    width = np.diff(border, append=border[0] + FULL_TURN)
    is_covered = arcs.hold(border + width / 2)
    covered_length = np.where(is_covered, arcs.end - arcs.begin, 0.0)
    chord = np.full((len(border), views), -1)
    for number in range(views):
        rows_of_view = np.flatnonzero(view == number)
        if len(rows_of_view):
            longest = rows_of_view[covered_length[:, rows_of_view].argmax(axis=1)]
            chord[:, number] = np.where(
                covered_length[np.arange(len(border)), longest] > 0, longest, -1
            )
    # Neighbouring intervals with the same chords are one piece.
    begin, end, rows = [], [], []
    for row, (start, step) in enumerate(zip(border, width, strict=True)):
        if len(rows) > 0 and (chord[rows[-1]] == chord[row]).all():
            end[-1] = start + step
        else:
            begin.append(start)
            end.append(start + step)
            rows.append(row)
    pieces = CirclePieces(np.array(begin), np.array(end), chord[rows])
    is_kept = ((pieces.chord >= 0).sum(axis=1) >= 2) & (pieces.end - pieces.begin > smallest_rad)
    return CirclePieces(*(column[is_kept] for column in pieces))


def fragments_of_pieces(
    views: tuple[str, ...],
    inputs: MatchInput,
    chords: Chords,
    circles: Circles,
    chord: Int[np.ndarray, "p v"],
    lines_mm: Float[np.ndarray, "p 2 3"],
    index: Int[np.ndarray, "p v"],
) -> tuple[Float[np.ndarray, "p v 2 2"], Float[np.ndarray, "p v 4 4"]]:
    """Fragments of the segments that correspond to pieces of rims, and their covariance.

    The covariance includes the distance between the segment and its arc, as an error of both
    ends.
    """
    view_positions = [views.index(name) for name in inputs.names]
    inputs_index = np.full(index.shape, -1)
    for view, position in enumerate(view_positions):
        number_of_segment = np.full(len(inputs.frames[0].exclusion_reasons[view]), -1)
        number_of_segment[inputs.order[view]] = np.arange(len(inputs.order[view]))
        inputs_index[:, view] = np.where(
            index[:, position] >= 0, number_of_segment[np.maximum(index[:, position], 0)], -1
        )
    bounds_here = view_ends_line(inputs, inputs_index, lines_mm)
    interval = np.clip(line_end_positions(inputs, inputs_index, lines_mm), 0.0, 1.0)
    part_ends, covariance = cut_fragments(inputs, inputs_index, interval, bounds_here)
    fragments = np.full(part_ends.shape, np.nan)
    fragment_covariance = np.full(covariance.shape, np.nan)
    for view, position in enumerate(view_positions):
        rows = np.flatnonzero(index[:, position] >= 0)
        direction = part_ends[rows, view, 1] - part_ends[rows, view, 0]
        direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        bow_px = _bows(chords, circles, chord[rows, position])
        part_covariance = covariance[rows, view]
        add_error_of_ends(
            part_covariance, np.repeat((bow_px[:, None] * normal)[:, None], 2, axis=1)
        )
        fragment_covariance[rows, position] = part_covariance
        lens = inputs.frames[0].cameras.intrinsics[view]
        fragments[rows, position] = distort_pixels(lens, part_ends[rows, view])
    return fragments, fragment_covariance


def _bows(chords: Chords, circles: Circles, row: Int[np.ndarray, "p"]) -> Float[np.ndarray, "p"]:
    """Distance between each chord and its arc, px, in the middle between their intersections.

    The arc is that of the circle nearest to the chord.
    """
    if len(row) == 0:
        return np.zeros(0)
    unique, inverse = np.unique(row, return_inverse=True)
    offset_px = circle_offsets(take_rows(chords, unique), circles).offset_px
    nearest = np.abs(offset_px[..., ON_ARC]).max(axis=2).argmin(axis=0)
    offset_px = offset_px[nearest, np.arange(len(unique))]
    return np.abs(offset_px[:, MIDDLE] - offset_px[:, ON_ARC].mean(axis=1))[inverse]


class FittedRim(NamedTuple):
    """One fitted rim.

    circle : one row.
    covariance : of the parameters of `move_circle`.
    chord_rows : rows of its chords.
    arcs : arcs that the chords cover.
    covered_share : share of the circle that two views show.
    support : total length of its chords, px, weighted by their distance from the circle.
    only_two_views : True if only two views have chords on it.
    """

    circle: Circles
    covariance: Float[np.ndarray, "6 6"]
    chord_rows: Int[np.ndarray, "k"]
    arcs: Arcs
    covered_share: float
    support: float
    only_two_views: bool


class RimChoice(NamedTuple):
    """Accepted rims, and the number of ambiguous ones that were rejected."""

    rims: list[FittedRim]
    ambiguous: int


class RimPieces(NamedTuple):
    """Pieces of rims as rows of matches.

    chord : (p, v) chord in each view, -1 if none.
    posterior : posterior of its rim.
    """

    chord: Int[np.ndarray, "p v"]
    lines_mm: Float[np.ndarray, "p 2 3"]
    covariance_mm2: Float[np.ndarray, "p 6 6"]
    posterior: Float[np.ndarray, "p"]


def build_rims(
    matches: Matches,
    inputs: MatchInput,
    chords: Chords,
    choice: RimChoice,
    mm_per_px: float,
    tuning: RimTuning,
) -> Rims:
    """Build the result from the accepted rims, with chords sorted by view and segment."""
    views, fitted_rims = len(matches.views), choice.rims
    parts = [
        _pieces(rim_of_chord, chords, views, mm_per_px, tuning) for rim_of_chord in fitted_rims
    ]
    empty = RimPieces(
        np.zeros((0, views), np.int64), np.zeros((0, 2, 3)), np.zeros((0, 6, 6)), np.zeros(0)
    )
    pieces = concatenate_rows([empty, *parts])
    rim_of_chord = np.full(len(chords.view), -1)
    for number, fitted_rim in enumerate(fitted_rims):
        rim_of_chord[fitted_rim.chord_rows] = number
    circles = concatenate_rows([_NO_CIRCLES, *(fitted_rim.circle for fitted_rim in fitted_rims)])
    tracks = tracks_beside_rims(matches, chords, circles, rim_of_chord, mm_per_px, tuning)
    chord_rows = np.flatnonzero(rim_of_chord >= 0)
    chord_rows = chord_rows[
        np.lexsort((chords.segment[chord_rows], chords.view[chord_rows], rim_of_chord[chord_rows]))
    ]
    counts = count_tracks(len(fitted_rims), matches, tracks, len(pieces.chord))
    counts["rims of two views that fit another as well"] = choice.ambiguous
    rows = _match_rows(matches.views, inputs, chords, circles, pieces)
    extended = with_rows(matches, tracks, rows)
    return Rims(
        matches.views,
        *circles,
        np.array([_public_covariance(fitted_rim) for fitted_rim in fitted_rims]).reshape(-1, 7, 7),
        np.array([fitted_rim.covered_share for fitted_rim in fitted_rims]),
        rim_of_chord[chord_rows],
        chords.view[chord_rows],
        chords.segment[chord_rows],
        dataclasses.replace(extended, counts=matches.counts | counts),
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
    smallest_rad = tuning.end_px * mm_per_px / radius
    pieces = cut_pieces(rim.arcs, chords.view[rim.chord_rows], views, smallest_rad)
    angle = np.stack([pieces.begin, pieces.end], axis=1)
    ends = points_on_circles(circle, angle.reshape(1, -1)).reshape(-1, 2, 3)
    radial = (ends - circle.centre_mm[0]) / radius
    slope = np.zeros((len(ends), 2, 3, 6))
    slope[..., :3] = np.eye(3)
    # If the normal turns toward an axis, points along that axis sink.
    across = radial @ complete_axes(circle.normal)[0].T
    slope[..., 3:5] = -radius * across[:, :, None] * circle.normal[0][:, None]
    slope[..., 5] = radial
    slope = slope.reshape(-1, 6, 6)
    covariance = slope @ rim.covariance @ slope.mT
    add_error_of_ends(covariance, (tuning.end_px * mm_per_px) * cross_3d(circle.normal, radial))
    chord = np.where(pieces.chord >= 0, rim.chord_rows[np.maximum(pieces.chord, 0)], -1)
    return RimPieces(chord, ends, covariance, np.full(len(chord), tuning.posterior))


def _public_covariance(rim: FittedRim) -> Float[np.ndarray, "7 7"]:
    """Covariance of centre, normal and radius of a rim, (7, 7)."""
    slope = np.zeros((7, 6))
    slope[:3, :3], slope[6, 5] = np.eye(3), 1.0
    slope[3:6, 3:5] = complete_axes(rim.circle.normal)[0].T
    return slope @ rim.covariance @ slope.T


def _match_rows(
    views: tuple[str, ...],
    inputs: MatchInput,
    chords: Chords,
    circles: Circles,
    pieces: RimPieces,
) -> dict[str, np.ndarray]:
    """Pieces as rows of matches, by field name."""
    count = len(pieces.chord)
    is_observed = pieces.chord >= 0
    index = np.where(is_observed, chords.segment[np.maximum(pieces.chord, 0)], -1)
    fragments, covariance = fragments_of_pieces(
        views, inputs, chords, circles, pieces.chord, pieces.lines_mm, index
    )
    return {
        "index": index,
        "fragments_px": fragments,
        "lines_mm": pieces.lines_mm,
        "covariance_mm2": pieces.covariance_mm2,
        "stage": np.where(is_observed.sum(axis=1) > 2, TRINOCULAR, BINOCULAR),
        "posterior": pieces.posterior,
        "rival_posterior": np.zeros(count),
        "fragments_covariance_px2": covariance,
        "misfit": np.zeros(count),
        "viewpoint_dependent": np.zeros(count, dtype=bool),
    }
