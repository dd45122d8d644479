"""From matches to rims."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from trinoc.geometry import Rig, Segments
from trinoc.match.observations import prepare, with_noise_scale
from trinoc.match.rims.answer import Fitted, answer_of
from trinoc.match.rims.circles import (
    ON_ARC,
    Chords,
    Circles,
    Off,
    chords_of,
    off_circles,
    touching,
)
from trinoc.match.rims.fit import fitted
from trinoc.match.rims.given import mm_per_px_of, segments_of_views
from trinoc.match.rims.hypotheses import MOST_AT_ONCE, hypotheses, in_parts
from trinoc.match.rims.pieces import arcs_of, covered_by_two
from trinoc.match.rims.rims import Rims
from trinoc.match.tracks import Matches
from trinoc.match.tuning import DEFAULT, MatchTuning, RimTuning
from trinoc.numerics import ArrayLike, in_float64, take_rows

# Of the circles of most support so many are fitted before the best is chosen, and so many times at
# most.
_AT_ONCE, _MOST_ROUNDS = 6, 40


@in_float64
def find_rims(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    tuning: MatchTuning = DEFAULT,
) -> Rims:
    """Circles in space whose arcs the views show in chords, such as rims of cylinders.

    Chords of one arc are cut at other places in every view, so that matched chords are near the
    arc, and not on it. All chords of a rim, in all views, leave six numbers: its centre, its plane
    and its radius. Circles are suggested by pairs of matched lines, judged by the segments of all
    views, and put out where chords of two views show more than a quarter. Tracks of their chords
    are replaced by pieces of the circle, cut where segments end; tracks of the body's outlines
    below a rim are marked (`Matches.silhouette`).

    Parameters
    ----------
    matches : of `match_segments` or `guide_matches`.
    segments : those that were matched, found with `arcs=True`: else there are hardly any chords.
    rig : the cameras that they were matched with, which count as exact.
    tuning : every tuned constant; `rims` are those of this function.

    Raises
    ------
    InputError : views of the matches without segments.
    """
    stated = prepare(segments_of_views(segments, matches.views), rig, None)
    # Matched chords disagree: what that makes of their errors is none of the rims'.
    chords = chords_of(stated, matches.views, tuning.rims)
    seen = with_noise_scale(stated, np.array([matches.noise_scale]))
    scale = mm_per_px_of(matches.lines_mm, rig, matches.views)
    start = hypotheses(matches.lines_mm, scale, tuning.rims)
    found = _chosen(chords, start, tuning.rims)
    return answer_of(matches, seen, chords, found, scale, tuning.rims)


def _chosen(chords: Chords, start: Circles, tuning: RimTuning) -> list[Fitted]:
    """Rims, one after the other, those of the longest chords first; a chord belongs to one."""
    at_once = max(MOST_AT_ONCE // (8 * max(len(chords.view), 1)), 1)
    support = np.concatenate(
        [
            _support(chords, off_circles(chords, take_rows(start, rows)), tuning.first_px, tuning)
            for rows in in_parts(len(start.radius_mm), at_once)
        ]
    )
    views = int(chords.view.max(initial=-1)) + 1
    by_view = (chords.view[:, None] == np.arange(views)).astype(np.float64)
    free, found = np.ones(len(chords.view), dtype=bool), []
    for _ in range(_MOST_ROUNDS):
        # Some of a circle's chords lie further off before it is fitted.
        number = ((support > 0) & free) @ by_view >= tuning.least_chords - 1
        total = np.where(number.sum(axis=1) >= 2, support @ free, 0.0)
        tried = np.argsort(-total, kind="stable")[:_AT_ONCE]
        tried = tried[total[tried] > 0]
        if len(tried) == 0:
            break
        rims = [
            _fitted(chords, take_rows(start, np.array([row])), free, views, tuning)
            for row in tried.tolist()
        ]
        rim = max(rims, key=lambda each: -1.0 if each is None else each.support)
        if rim is None:
            support[tried] = 0.0
        else:
            free[rim.own] = False
            found.append(rim)
    return found


def _support(
    chords: Chords, off: Off, within_px: float, tuning: RimTuning
) -> Float[np.ndarray, "h n"]:
    """Length of the chords that touch circles; those that lie near count for more, so that of the
    circles about one rim the truest comes first."""
    apart = np.abs(off.px[..., ON_ARC]).max(axis=2) / within_px
    weight = np.sqrt(np.clip(1 - apart, 0.0, 1.0)) * chords.length_px
    return np.where(touching(off, within_px, tuning), weight, 0.0)


def _fitted(
    chords: Chords, circle: Circles, free: np.ndarray, views: int, tuning: RimTuning
) -> Fitted | None:
    """The rim near a circle; None where too little touches it."""
    covariance = np.zeros((6, 6))
    between = (tuning.first_px + tuning.last_px) / 2
    for within in (tuning.first_px, between, tuning.last_px, tuning.last_px):
        touch = touching(off_circles(chords, circle), within, tuning)[0]
        own = np.flatnonzero(touch & free)
        if np.sort(np.bincount(chords.view[own], minlength=views))[-2] < tuning.least_chords:
            return None
        circle, covariance, _ = fitted(take_rows(chords, own), circle)
    off = off_circles(chords, circle, with_ends=True)
    support = _support(chords, off, tuning.last_px, tuning)[0] * free
    own = np.flatnonzero(support > 0)
    if np.sort(np.bincount(chords.view[own], minlength=views))[-2] < tuning.least_chords:
        return None
    arcs = arcs_of(off.around_mm[0, own], circle)
    covered = covered_by_two(arcs, chords.view[own], views)
    if covered < tuning.least_covered:
        return None
    return Fitted(circle, covariance, own, arcs, covered, float(support.sum()))
