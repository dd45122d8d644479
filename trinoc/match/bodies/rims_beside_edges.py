"""Rims beside matches of straight edges."""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Int

from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.bodies.circles import (
    ON_ARC,
    Chords,
    Circles,
    collect_chords,
    off_circles,
    touching,
)
from trinoc.match.bodies.explained_tracks import count_tracks, tracks_beside_rims, with_rows
from trinoc.match.bodies.rim_search import usual_mm_per_px
from trinoc.match.bodies.rims import Rims
from trinoc.match.observations.match_input import prepare
from trinoc.match.observations.pictures_of_views import segments_of_views
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.bodies import RimTuning
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.precision import ArrayLike, in_float64

_ROWS = (
    "index",
    "fragments_px",
    "lines_mm",
    "covariance_mm2",
    "stage",
    "posterior",
    "rival_posterior",
    "fragments_covariance_px2",
    "misfit",
    "viewpoint_dependent",
)


class MatchesWithRims(eqx.Module):
    """Matches of straight edges and pieces of rims, and the segments that they number.

    Fields
    ------
    segments : of each view, those that were given, in their order, and after them chords of rims.
    matches : the given tracks that no rim explains, in their order, and after them pieces of rims;
        tracks that hold an outline of the body below a rim have the mark "silhouette".
    kept : (k,) the numbers that the first k tracks had before.
    """

    segments: dict[str, Segments]
    matches: Matches
    kept: Int[np.ndarray, "k"]


@in_float64
def add_rims(
    matches: Matches,
    segments: Mapping[str, Segments | ArrayLike],
    rims: Rims,
    chords: Mapping[str, Segments | ArrayLike],
    rig: Rig,
    *,
    tuning: MatchTuning = DEFAULT,
) -> MatchesWithRims:
    """Matches of straight edges, with the rims that were found among the chords of arcs.

    A detector that keeps the chords of arcs (`find_segments(arcs=True)`) keeps what is no edge,
    too. So edges are matched without them, rims are found with them, and joined here.

    Parameters
    ----------
    matches : of `match_segments` or `guide_matches`, of segments without arcs.
    segments : those that were matched.
    rims : of `find_rims`, of segments with arcs.
    chords : the segments that the rims were found among.
    rig : the cameras of both.
    tuning : every tuned constant; `rims` are those of this function.

    Raises
    ------
    InputError : views without segments, or rims of other views than the matches.
    """
    views = matches.views
    given, more = (segments_of_views("Adding rims", views, each) for each in (segments, chords))
    if rims.views != views:
        raise InputError(
            f"The rims are of the views {', '.join(rims.views)}, but the matches of "
            f"{', '.join(views)}: find both in the same pictures, the views in one order."
        )
    own = collect_chords(prepare(given, rig, None), views, tuning.rims)
    circles = Circles(rims.centre_mm, rims.normal, rims.radius_mm)
    rim = _assign_rims(own, circles, tuning.rims)
    scale = usual_mm_per_px(matches.lines_mm, rig, views)
    tracks = tracks_beside_rims(matches, own, circles, rim, scale, tuning.rims)
    first = len(rims.kept)
    rows = {name: np.asarray(getattr(rims.matches, name))[first:].copy() for name in _ROWS}
    joined, reasons = {}, {}
    for view, name in enumerate(views):
        column = rows["index"][:, view]
        used = np.unique(column[column >= 0])
        column[column >= 0] = len(given[name]) + np.searchsorted(used, column[column >= 0])
        joined[name] = given[name].append(more[name].take(used))
        reasons[name] = np.concatenate([matches.reasons[name], np.full(len(used), "matched")])
    counts = count_tracks(len(rims), matches, tracks, len(rows["index"]))
    before = dataclasses.replace(matches, reasons=reasons, counts=matches.counts | counts)
    return MatchesWithRims(joined, with_rows(before, tracks, rows), tracks.kept)


def _assign_rims(chords: Chords, circles: Circles, tuning: RimTuning) -> Int[np.ndarray, "n"]:
    """The rim that each segment is a chord of, the nearest of several; -1 for none."""
    if len(circles.radius_mm) == 0:
        return np.full(len(chords.view), -1)
    off = off_circles(chords, circles)
    apart = np.abs(off.px[..., ON_ARC]).max(axis=2)
    apart = np.where(touching(off, tuning.last_px, tuning), apart, np.inf)
    return np.where(np.isfinite(apart.min(axis=0)), apart.argmin(axis=0), -1)
