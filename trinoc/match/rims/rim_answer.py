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
    """Arcs of one circle: intervals of the angle, rad.

    `begin` is in [0, 2 pi), and `end` may exceed 2 pi.
    """

    begin: Float[np.ndarray, "n"]
    end: Float[np.ndarray, "n"]

    def contain(self, angle: Float[np.ndarray, "a"]) -> Bool[np.ndarray, "a n"]:
        """Return the mask of the arcs that contain each angle, (a, n)."""
        return (angle[:, None] - self.begin) % FULL_TURN < self.end - self.begin


class CirclePieces(NamedTuple):
    """Pieces of a circle.

    Attributes
    ----------
    begin, end : (p,)
        Angles of the ends, rad.
    chord : (p, v)
        Chord of each view on the piece, -1 if none.
    """

    begin: Float[np.ndarray, "p"]
    end: Float[np.ndarray, "p"]
    chord: Int[np.ndarray, "p v"]


def cover_circle(nearest_mm: Float[np.ndarray, "n 5 3"], circle: Circles) -> Arcs:
    """Return the arc of a circle that each chord covers.

    `nearest_mm` are the points of the circle nearest to the five points of each chord.
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
    """Return the share of the circle on which two or more views have a chord, 0 to 1.

    `view` is the view of each arc, `views` the number of views.
    """
    border = np.unique(np.concatenate([arcs.begin, arcs.end]) % FULL_TURN)
    if len(border) == 0:
        return 0.0
    width = np.diff(border, append=border[0] + FULL_TURN)
    view_count = arcs.contain(border + width / 2) @ (view[:, None] == np.arange(views))
    return float(width[view_count.sum(axis=1) >= 2].sum() / FULL_TURN)


def cut_pieces(
    arcs: Arcs, view: Int[np.ndarray, "n"], views: int, smallest_rad: float
) -> CirclePieces:
    """Cut a circle at the ends of its chords, and return the pieces that two or more views show.

    If several chords of a view show a piece, the one with the longest arc is used. Pieces shorter
    than `smallest_rad` are dropped.
    """
    border = np.unique(np.concatenate([arcs.begin, arcs.end]) % FULL_TURN)
    width = np.diff(border, append=border[0] + FULL_TURN)
    is_covered = arcs.contain(border + width / 2)
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
    """Return the fragment of each segment on a piece of a rim, and the covariance of its ends.

    The covariance includes the distance between the segment and its arc, as an error of both ends.
    `chord` are rows of `chords`. `index` are the same segments in the caller's numbering.
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
        bow_px = _chord_to_arc_px(chords, circles, chord[rows, position])
        part_covariance = covariance[rows, view]
        add_error_of_ends(
            part_covariance, np.repeat((bow_px[:, None] * normal)[:, None], 2, axis=1)
        )
        fragment_covariance[rows, position] = part_covariance
        lens = inputs.frames[0].cameras.intrinsics[view]
        fragments[rows, position] = distort_pixels(lens, part_ends[rows, view])
    return fragments, fragment_covariance


def _chord_to_arc_px(
    chords: Chords, circles: Circles, row: Int[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """Return the distance between each chord and its arc, (p,) px.

    The distance is measured midway between the two points where chord and arc intersect. The arc
    belongs to the circle nearest to the chord. `row` are rows of `chords`.
    """
    if len(row) == 0:
        return np.zeros(0)
    unique, inverse = np.unique(row, return_inverse=True)
    offset_px = circle_offsets(take_rows(chords, unique), circles).offset_px
    nearest = np.abs(offset_px[..., ON_ARC]).max(axis=2).argmin(axis=0)
    offset_px = offset_px[nearest, np.arange(len(unique))]
    return np.abs(offset_px[:, MIDDLE] - offset_px[:, ON_ARC].mean(axis=1))[inverse]


class FittedRim(NamedTuple):
    """One fitted rim with its chords.

    Attributes
    ----------
    circle : Circles
        The circle; its arrays have one row.
    covariance : (6, 6)
        Covariance of the parameters of `move_circle`.
    chord_rows : (k,)
        Rows of its chords in `Chords`.
    arcs : Arcs
        Arc that each chord covers.
    covered_share : float
        Share of the circle that two or more views show.
    support : float
        Total length of its chords, px, weighted by their distance from the circle.
    only_two_views : bool
        True if only two views have chords of it.
    """

    circle: Circles
    covariance: Float[np.ndarray, "6 6"]
    chord_rows: Int[np.ndarray, "k"]
    arcs: Arcs
    covered_share: float
    support: float
    only_two_views: bool


class RimChoice(NamedTuple):
    """Accepted rims, and the number of rims that were rejected as ambiguous."""

    rims: list[FittedRim]
    ambiguous: int


class RimPieces(NamedTuple):
    """Pieces of rims, approximated by straight lines in space.

    Attributes
    ----------
    chord : (p, v)
        Row of the chord of each view in `Chords`, -1 if none.
    lines_mm, covariance_mm2 : (p, 2, 3) and (p, 6, 6)
        Ends of the piece, world frame, and their covariance.
    posterior : (p,)
        Posterior of its rim.
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
    """Build the result from the accepted rims. The chords are sorted by rim, view and segment."""
    views, fitted_rims = len(matches.views), choice.rims
    parts = [
        _build_pieces(fitted_rim, chords, views, mm_per_px, tuning) for fitted_rim in fitted_rims
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


def _build_pieces(
    rim: FittedRim, chords: Chords, views: int, mm_per_px: float, tuning: RimTuning
) -> RimPieces:
    """Return the pieces of one rim as lines in space, with their covariance."""
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
    """Return the covariance of centre (mm), normal and radius (mm) of a rim, (7, 7)."""
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
    """Return the pieces as columns of `Matches`, by field name."""
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
