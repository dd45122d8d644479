"""What rims leave of matches: tracks that none explains, those of outlines below rims marked; and
rims beside matches of straight edges."""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.errors import InputError, list_names
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.observations.match_input import prepare
from trinoc.match.observations.pictures_of_views import segments_of_views
from trinoc.match.rims.circles import (
    ENDS,
    ON_ARC,
    Chords,
    Circles,
    collect_chords,
    off_circles,
    touching,
    usual_mm_per_px,
)
from trinoc.match.rims.rims import Rims
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.values import Value
from trinoc.numerics.vectors import cross_3d


def are_outlines(
    chords: Chords, circles: Circles, mm_per_px: float, tuning: RimTuning
) -> Bool[np.ndarray, "n"]:
    """Whether the rays of a segment's ends touch the cylinder over any of the circles, one of them
    nearer to it than its radius."""
    found = np.zeros(len(chords.view), dtype=bool)
    rays = chords.rays[:, ENDS]
    within_mm = 2 * tuning.touch_px * mm_per_px
    for centre, axis, radius in zip(*circles, strict=True):
        across = cross_3d(rays, axis)
        sine = np.maximum(np.linalg.norm(across, axis=2), 1e-9)
        off = (chords.centre_mm - centre)[:, None]
        distance = np.abs((off * across).sum(axis=2)) / sine
        height = abs_height(rays, off, axis)
        near = np.abs(distance - radius).max(axis=1) < within_mm
        begins = height.min(axis=1) < radius
        # From the rim down: a line across it does not leave its plane.
        leaves = height.max(axis=1) - height.min(axis=1) > within_mm
        found |= near & begins & leaves
    return found


def abs_height(
    rays: Float[np.ndarray, "n e 3"],
    off_mm: Float[np.ndarray, "n 1 3"],
    axis: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "n e"]:
    """How far from the circle's plane, along its axis, the rays pass nearest to the axis."""
    cosine = rays @ axis
    along, up = (rays * off_mm).sum(axis=2), off_mm @ axis
    depth = (cosine * up - along) / np.maximum(1 - cosine**2, 1e-12)
    return np.abs(up + depth * cosine)


class TracksBesideRims(NamedTuple):
    """kept : (k,) the tracks that no rim explains. silhouette : (k,) probability that each holds an
    outline. outlines : how many are thought to."""

    kept: Int[np.ndarray, "k"]
    silhouette: Float[np.ndarray, "k"]
    outlines: int


def tracks_beside_rims(
    matches: Matches,
    chords: Chords,
    circles: Circles,
    rim: Int[np.ndarray, "n"],
    mm_per_px: float,
    tuning: RimTuning,
) -> TracksBesideRims:
    """What rims leave of the tracks; `rim` is that of each segment, -1 for none."""
    kept = np.flatnonzero(~_explains_tracks(matches, chords, rim))
    outline = are_outlines(chords, circles, mm_per_px, tuning) & (rim < 0)
    held = _on_tracks(matches, chords, outline).sum(axis=1) >= 2
    mark = np.where(held, tuning.posterior, 0.0)[kept]
    if "silhouette" in matches.marks:
        mark = np.maximum(mark, matches.marks["silhouette"][kept])
    return TracksBesideRims(kept, mark, int(held[kept].sum()))


def count_tracks(
    rims: int, matches: Matches, tracks: TracksBesideRims, pieces: int
) -> dict[str, int]:
    """What became of the tracks, by name."""
    return {
        "rims": rims,
        "tracks that rims explain": len(matches) - len(tracks.kept),
        "pieces of rims": pieces,
        "tracks of outlines below rims": tracks.outlines,
    }


def with_rows(
    matches: Matches, tracks: TracksBesideRims, rows: Mapping[str, np.ndarray]
) -> Matches:
    """The tracks that are kept, and after them the rows of pieces, whose segments are matched."""
    index = rows["index"]
    # Nothing is known of what the rig adds to the rows.
    matches = dataclasses.replace(matches, rig_covariance_mm2=None)
    if matches.member_posterior is not None:
        members = np.where(index >= 0, np.asarray(rows["posterior"])[:, None], np.nan)
        rows = {**rows, "member_posterior": members}
    silhouette = np.append(tracks.silhouette, np.zeros(len(index)))
    longer = matches.take(tracks.kept).append(rows).with_marks(silhouette=silhouette)
    words = {name: column.copy() for name, column in matches.reasons.items()}
    for view, name in enumerate(matches.views):
        words[name][index[index[:, view] >= 0, view]] = "matched"
    return dataclasses.replace(longer, reasons=words)


def _on_tracks(
    matches: Matches, chords: Chords, which: Bool[np.ndarray, "n"]
) -> Bool[np.ndarray, "t v"]:
    """Whether the segment of each view on each track is one of these."""
    found = np.zeros(matches.index.shape, dtype=bool)
    for view in range(matches.index.shape[1]):
        own = chords.segment[which & (chords.view == view)]
        found[:, view] = np.isin(matches.index[:, view], own)
    return found


def _explains_tracks(
    matches: Matches, chords: Chords, rim: Int[np.ndarray, "n"]
) -> Bool[np.ndarray, "t"]:
    """Tracks of which two segments are chords of one rim, or one of two is a rim's chord."""
    number = np.zeros(len(matches), dtype=np.int64)
    for each in range(rim.max(initial=-1) + 1):
        number = np.maximum(number, _on_tracks(matches, chords, rim == each).sum(axis=1))
    return number > np.where((matches.index >= 0).sum(axis=1) > 2, 1, 0)


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


class MatchesWithRims(Value):
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
    matches : of `match_segments`, of segments without arcs.
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
            f"The rims are of the views {list_names(rims.views)}, but the matches of "
            f"{list_names(views)}: find both in the same pictures, the views in one order."
        )
    own = collect_chords(prepare(given, rig, None), views)
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
    apart = np.where(touching(off, tuning.touch_px, tuning), apart, np.inf)
    return np.where(np.isfinite(apart.min(axis=0)), apart.argmin(axis=0), -1)
