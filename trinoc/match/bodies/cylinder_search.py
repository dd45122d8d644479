"""From matches to cylinders."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit

from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.bodies.cylinder_fit import Fits, Members
from trinoc.match.bodies.cylinder_hypotheses import propose_cylinders
from trinoc.match.bodies.cylinder_support import assign_outlines, support_log_odds, with_support
from trinoc.match.bodies.cylinders import Cylinders
from trinoc.match.bodies.outlines import Outlines, abreast_mm, possible_outlines
from trinoc.match.observations.match_input import prepare, with_noise_scale
from trinoc.match.observations.pictures_of_views import segments_of_views
from trinoc.match.tracks.matches import EVEN, Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.tables import take_rows
from trinoc.numerics.tails import chi_square_limit
from trinoc.numerics.vectors import add_error_of_ends, complete_axes


class CylinderChoice(NamedTuple):
    """row : of the cylinders put out, the likeliest first. rival : posterior of the best other
    cylinder that shares an outline with each."""

    row: Int[np.ndarray, "c"]
    rival: Float[np.ndarray, "c"]


def choose_cylinders(
    fits: Fits, members: Members, log_odds: Float[np.ndarray, "h"], tuning: MatchTuning
) -> CylinderChoice:
    """The likeliest first, then those that share no outline with any of them."""
    posterior = expit(log_odds)
    left = posterior >= EVEN
    found, rivals = [], []
    for row in np.argsort(-log_odds, kind="stable").tolist():
        if not left[row]:
            continue
        own = members.row[row][members.held[row]]
        sharing = np.isin(members.row, own).any(axis=1)
        left &= ~sharing
        other = np.flatnonzero(sharing)
        other = other[differs(fits, row, other, tuning.collinear.significance)]
        found.append(row)
        rivals.append(posterior[other].max(initial=0.0))
    return CylinderChoice(np.array(found, dtype=np.int64), np.array(rivals))


def differs(
    fits: Fits, row: int, others: Int[np.ndarray, "o"], significance: float
) -> Bool[np.ndarray, "o"]:
    """Whether others are another cylinder, by the errors of both."""
    direction, across = fits.direction[row], complete_axes(fits.direction[row])
    along = fits.direction[others] @ direction
    way = fits.direction[others] * np.where(along < 0, -1.0, 1.0)[:, None]
    apart = fits.point_mm[others] - fits.point_mm[row]
    reach = (apart @ direction) / np.maximum(np.abs(along), 1e-6)
    offset = (apart - reach[:, None] * way) @ across.T
    change = np.column_stack([offset, way @ across.T, fits.radius_mm[others] - fits.radius_mm[row]])
    # The others' own errors are taken as large as this one's.
    square = 0.5 * np.einsum("op,pq,oq->o", change, fits.information[row], change)
    return square > chi_square_limit(significance, change.shape[1])


def place_ends(
    table: Outlines, fits: Fits, members: Members, free_end_px: float
) -> tuple[Float[np.ndarray, "c 2 3"], Float[np.ndarray, "c 7 7"]]:
    """(ends of each axis as far as two outlines reach, covariance of both and the radius)."""
    own = members.rows_of(table)
    along = np.sort(abreast_mm(own.rays, fits.point_mm[:, None], fits.direction[:, None]), axis=2)
    mm_per_px = ((along[..., 1] - along[..., 0]) / own.length_px * members.held).sum(axis=1)
    mm_per_px = mm_per_px / np.maximum(members.held.sum(axis=1), 1)
    reach = _reach_of_two(along, assign_outlines(table, members))
    axis = fits.point_mm[:, None] + reach[:, :, None] * fits.direction[:, None]
    across = complete_axes(fits.direction)
    count = len(reach)
    jacobian = np.zeros((count, 7, 5))
    for end in (0, 1):
        rows = slice(3 * end, 3 * end + 3)
        jacobian[:, rows, :2] = across.mT
        jacobian[:, rows, 2:4] = reach[:, end, None, None] * across.mT
    jacobian[:, 6, 4] = 1.0
    covariance = jacobian @ fits.covariance @ jacobian.mT
    stops = (free_end_px * mm_per_px)[:, None] * fits.direction
    add_error_of_ends(covariance, np.stack([stops, stops], axis=1))
    return axis, covariance


def _reach_of_two(
    along_mm: Float[np.ndarray, "c k 2"], outline: np.ndarray
) -> Float[np.ndarray, "c 2"]:
    """From where to where at least two outlines, each with all its pieces, reach."""
    count, number = len(along_mm), int(outline.max(initial=1)) + 1
    low, high = np.full((count, number), np.inf), np.full((count, number), -np.inf)
    owner, column = np.nonzero(outline >= 0)
    of = outline[owner, column]
    np.minimum.at(low, (owner, of), along_mm[owner, column, 0])
    np.maximum.at(high, (owner, of), along_mm[owner, column, 1])
    return np.stack([np.sort(low, axis=1)[:, 1], np.sort(high, axis=1)[:, -2]], axis=1)


@in_float64
def find_cylinders(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    tuning: MatchTuning = DEFAULT,
) -> Cylinders:
    """Right circular cylinders by their outlines, and which tracks are none of an edge.

    Each view sees another line of a round body, where its rays touch it: matched, they are a line
    that is not there. Two outlines in one view and two more in others, at least, leave an axis and
    a radius. Segments that three views place in space are none. A cylinder is judged against
    chance and against the tracks that it would undo, and outlines that leave it open are not
    put out (`counts`). Nothing is dropped from the matches: `Cylinders.silhouette` is the
    probability that a track holds an outline.

    Parameters
    ----------
    matches : of `match_segments`.
    segments : those that were matched.
    rig : the cameras that they were matched with, which count as exact.
    tuning : every tuned constant; `cylinders` are those of this function.

    Raises
    ------
    InputError : views of the matches without segments.
    """
    given = segments_of_views("Finding cylinders", matches.views, segments)
    seen = with_noise_scale(prepare(given, rig, None), np.array([matches.noise_scale]))
    table = possible_outlines(seen, matches, tuning.cylinders)
    start = propose_cylinders(table, len(matches.views), tuning)
    fits, members = with_support(table, start, tuning)
    odds = support_log_odds(table, fits, members, matches, tuning)
    best = choose_cylinders(fits, members, odds, tuning)
    counts = {
        "possible outlines": len(table.view),
        "cylinders that three outlines suggest": len(start.radius_mm),
        "cylinders that four outlines or more touch": len(fits.radius_mm),
        "cylinders": len(best.row),
    }
    return _answer(
        table, take_rows(fits, best.row), members, best, expit(odds), matches, counts, tuning
    )


def _answer(
    table: Outlines,
    fits: Fits,
    members: Members,
    best: CylinderChoice,
    posterior: Float[np.ndarray, "h"],
    matches: Matches,
    counts: dict[str, int],
    tuning: MatchTuning,
) -> Cylinders:
    """The cylinders put out, with their outlines in the order of views and segments."""
    own = take_rows(members, best.row)
    axis, covariance = place_ends(table, fits, own, tuning.corners.free_end_px)
    cylinder, column = np.nonzero(own.held)
    row = own.row[cylinder, column]
    order = np.lexsort((table.segment[row], table.view[row], cylinder))
    cylinder, row, side = cylinder[order], row[order], own.side[cylinder, column][order]
    view, segment = table.view[row], table.segment[row]
    silhouette = np.zeros(len(matches))
    for number, name in enumerate(matches.views):
        of_segment = np.zeros(len(matches.reasons[name]) + 1)
        here = view == number
        of_segment[segment[here]] = posterior[best.row][cylinder[here]]
        silhouette = np.maximum(silhouette, of_segment[matches.index[:, number]])
    return Cylinders(
        views=matches.views,
        axis_mm=axis,
        radius_mm=fits.radius_mm,
        covariance_mm2=covariance,
        posterior=posterior[best.row],
        rival_posterior=best.rival,
        chi_square=fits.square,
        degrees=fits.degrees,
        cylinder=cylinder,
        view=view,
        segment=segment,
        side=side.astype(np.int64),
        silhouette=silhouette,
        counts=counts,
    )
