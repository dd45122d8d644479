"""From matches to cylinders."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from trinoc.errors import InputError
from trinoc.geometry import Rig, Segments
from trinoc.match.cylinders.answer import Chosen, choose_cylinders, place_ends
from trinoc.match.cylinders.cylinders import Cylinders
from trinoc.match.cylinders.evidence import log_odds
from trinoc.match.cylinders.fit import Fits, Members
from trinoc.match.cylinders.hypotheses import hypotheses
from trinoc.match.cylinders.outlines import Outlines, possible_outlines
from trinoc.match.cylinders.support import with_support
from trinoc.match.observations import prepare, with_noise_scale
from trinoc.match.tracks import Matches
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.numerics import ArrayLike, in_float64


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
    matches : of `match_segments` or `guide_matches`.
    segments : those that were matched.
    rig : the cameras that they were matched with, which count as exact.
    tuning : every tuned constant; `cylinders` are those of this function.

    Raises
    ------
    InputError : views of the matches without segments.
    """
    missing = [name for name in matches.views if name not in segments]
    if missing:
        raise InputError(
            f'Cylinders need the segments of every view, but "{missing[0]}" has none: give what '
            f"was matched of {', '.join(matches.views)}."
        )
    given = {name: segments[name] for name in matches.views}
    seen = with_noise_scale(prepare(given, rig, None), np.array([matches.noise_scale]))
    table = possible_outlines(seen, matches, tuning.cylinders)
    start = hypotheses(table, len(matches.views), tuning.cylinders)
    fits, members = with_support(table, start, tuning.cylinders)
    odds = log_odds(table, fits, members, matches, tuning.cylinders)
    best = choose_cylinders(fits, members, odds, tuning.cylinders)
    counts = {
        "possible outlines": len(table.view),
        "cylinders that three outlines suggest": len(start.radius_mm),
        "cylinders that four outlines or more touch": len(fits.radius_mm),
        "cylinders": len(best.row),
    }
    return _answer(table, fits.take(best.row), members, best, expit(odds), matches, counts, tuning)


def _answer(
    table: Outlines,
    fits: Fits,
    members: Members,
    best: Chosen,
    posterior: Float[np.ndarray, "h"],
    matches: Matches,
    counts: dict[str, int],
    tuning: MatchTuning,
) -> Cylinders:
    """The cylinders put out, with their outlines in the order of views and segments."""
    own = Members(members.row[best.row], members.side[best.row])
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
