"""Combine rims with matches: remove tracks that a rim explains, mark outlines, and add pieces of
rims.
"""

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
    are_touching,
    circle_offsets,
    collect_chords,
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
    """Return the mask of the segments that may be an outline of the cylinder below a circle, (n,).

    The viewing rays of both ends must touch the cylinder. One of the rays must touch the cylinder
    near the circle.
    """
    is_outline = np.zeros(len(chords.view), dtype=bool)
    rays = chords.rays[:, ENDS]
    limit_mm = 2 * tuning.touch_px * mm_per_px
    for centre, axis, radius in zip(*circles, strict=True):
        across = cross_3d(rays, axis)
        sine = np.maximum(np.linalg.norm(across, axis=2), 1e-9)
        offset = (chords.centre_mm - centre)[:, None]
        distance = np.abs((offset * across).sum(axis=2)) / sine
        height = heights_of_closest_approach(rays, offset, axis)
        is_near = np.abs(distance - radius).max(axis=1) < limit_mm
        begins_at_rim = height.min(axis=1) < radius
        # An outline leaves the plane of the rim, and a line across the rim does not.
        leaves_plane = height.max(axis=1) - height.min(axis=1) > limit_mm
        is_outline |= is_near & begins_at_rim & leaves_plane
    return is_outline


def heights_of_closest_approach(
    rays: Float[np.ndarray, "n e 3"],
    offset_mm: Float[np.ndarray, "n 1 3"],
    axis: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "n e"]:
    """Return the distance from the circle's plane at which each ray is nearest to the axis, (n, e)
    mm.

    `axis` is the normal of the circle. `offset_mm` is the camera centre relative to the circle's
    centre.
    """
    cosine = rays @ axis
    ray_component, height_of_camera = (rays * offset_mm).sum(axis=2), offset_mm @ axis
    depth = (cosine * height_of_camera - ray_component) / np.maximum(1 - cosine**2, 1e-12)
    return np.abs(height_of_camera + depth * cosine)


class TracksBesideRims(NamedTuple):
    """Tracks that no rim explains, and that therefore remain in the result.

    A rim explains a track if the segments of the track are chords of the rim.

    Attributes
    ----------
    kept : (k,)
        Indices of the tracks.
    silhouette : (k,)
        Probability that the track contains an outline of a body below a rim.
    outlines : int
        Number of tracks that probably contain an outline.
    """

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
    """Select the tracks that no rim explains, and test them for outlines of bodies below rims.

    A rim explains a track if the track's segments are chords of the rim. `rim` (n,) is the
    rim that each segment is a chord of, -1 if none.
    """
    kept = np.flatnonzero(~_explains_tracks(matches, chords, rim))
    is_outline = are_outlines(chords, circles, mm_per_px, tuning) & (rim < 0)
    holds_outline = _segments_on_tracks(matches, chords, is_outline).sum(axis=1) >= 2
    silhouette = np.where(holds_outline, tuning.posterior, 0.0)[kept]
    if "silhouette" in matches.marks:
        silhouette = np.maximum(silhouette, matches.marks["silhouette"][kept])
    return TracksBesideRims(kept, silhouette, int(holds_outline[kept].sum()))


def count_tracks(
    rims: int, matches: Matches, tracks: TracksBesideRims, pieces: int
) -> dict[str, int]:
    """Return the numbers of rims, of tracks that rims explain, of pieces of rims, and of outline
    tracks.
    """
    return {
        "rims": rims,
        "tracks that rims explain": len(matches) - len(tracks.kept),
        "pieces of rims": pieces,
        "tracks of outlines below rims": tracks.outlines,
    }


def with_rows(
    matches: Matches, tracks: TracksBesideRims, rows: Mapping[str, np.ndarray]
) -> Matches:
    """Return the tracks that no rim explains, followed by the pieces of rims as further tracks.

    `rows` are the columns of the pieces, by field name of `Matches`. The segments of pieces get the
    reason "matched".
    """
    index = rows["index"]
    # The effect of the rig's errors on the new rows is not available.
    matches = dataclasses.replace(matches, rig_covariance_mm2=None)
    if matches.member_posterior is not None:
        members = np.where(index >= 0, np.asarray(rows["posterior"])[:, None], np.nan)
        rows = {**rows, "member_posterior": members}
    silhouette = np.append(tracks.silhouette, np.zeros(len(index)))
    extended = matches.take(tracks.kept).append(rows).with_marks(silhouette=silhouette)
    reasons = {name: column.copy() for name, column in matches.reasons.items()}
    for view, name in enumerate(matches.views):
        reasons[name][index[index[:, view] >= 0, view]] = "matched"
    return dataclasses.replace(extended, reasons=reasons)


def _segments_on_tracks(
    matches: Matches, chords: Chords, is_selected: Bool[np.ndarray, "n"]
) -> Bool[np.ndarray, "t v"]:
    """Return the mask of the views in which the track's segment is a selected chord, (t, v)."""
    is_on_track = np.zeros(matches.index.shape, dtype=bool)
    for view in range(matches.index.shape[1]):
        selected = chords.segment[is_selected & (chords.view == view)]
        is_on_track[:, view] = np.isin(matches.index[:, view], selected)
    return is_on_track


def _explains_tracks(
    matches: Matches, chords: Chords, rim: Int[np.ndarray, "n"]
) -> Bool[np.ndarray, "t"]:
    """Return the mask of the tracks that a rim explains, (t,).

    At least two segments of the track are chords of one rim. For tracks in two views, one segment
    is enough.
    """
    largest_count = np.zeros(len(matches), dtype=np.int64)
    for rim_number in range(rim.max(initial=-1) + 1):
        largest_count = np.maximum(
            largest_count, _segments_on_tracks(matches, chords, rim == rim_number).sum(axis=1)
        )
    return largest_count > np.where((matches.index >= 0).sum(axis=1) > 2, 1, 0)


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
    """Matches of straight edges together with pieces of rims.

    Attributes
    ----------
    segments : dict of Segments
        For each view, the segments of the straight edges in their sequence, followed by the chords
        of rims. The matches number these segments.
    matches : Matches
        The tracks that no rim explains, in their sequence, followed by pieces of rims. Tracks with
        an outline of the body below a rim have the mark "silhouette".
    kept : (k,)
        Indices that the first k tracks of `matches` had before the rims were added.
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
    """Combine matches of straight edges with rims that were detected in other segments.

    Parameters
    ----------
    matches : Matches
        Result of `match_segments` for segments without arcs.
    segments : mapping
        The matched segments of each view.
    rims : Rims
        Result of `find_rims` for segments with arcs.
    chords : mapping
        The segments of each view that the rims were detected in.
    rig : Rig
        The cameras of both.
    tuning : MatchTuning
        Tuned constants; the group `rims` is used here.

    Returns
    -------
    MatchesWithRims
        Matches of straight edges and pieces of rims, with their segments.

    Raises
    ------
    InputError
        If a view has no segments, or the rims have other views than the matches.

    Notes
    -----
    With `find_segments(arcs=True)` the detector keeps the chords of arcs, but also segments that
    are no straight edge. Edges are therefore matched without arcs, and rims are detected with arcs.
    This function combines both results.
    """
    views = matches.views
    edge_segments, chord_segments = (
        segments_of_views("Adding rims", views, segment_set) for segment_set in (segments, chords)
    )
    if rims.views != views:
        raise InputError(
            f"The rims are of the views {list_names(rims.views)}, but the matches are of the views "
            f"{list_names(views)}: find rims and matches in the same pictures, with the views in "
            "one order."
        )
    all_chords = collect_chords(prepare(edge_segments, rig, None), views)
    circles = Circles(rims.centre_mm, rims.normal, rims.radius_mm)
    rim = _assign_rims(all_chords, circles, tuning.rims)
    scale = usual_mm_per_px(matches.lines_mm, rig, views)
    tracks = tracks_beside_rims(matches, all_chords, circles, rim, scale, tuning.rims)
    first_piece = len(rims.kept)
    rows = {name: np.asarray(getattr(rims.matches, name))[first_piece:].copy() for name in _ROWS}
    all_segments, reasons = {}, {}
    for view, name in enumerate(views):
        column = rows["index"][:, view]
        used_chords = np.unique(column[column >= 0])
        column[column >= 0] = len(edge_segments[name]) + np.searchsorted(
            used_chords, column[column >= 0]
        )
        all_segments[name] = edge_segments[name].append(chord_segments[name].take(used_chords))
        reasons[name] = np.concatenate(
            [matches.reasons[name], np.full(len(used_chords), "matched")]
        )
    counts = count_tracks(len(rims), matches, tracks, len(rows["index"]))
    extended = dataclasses.replace(matches, reasons=reasons, counts=matches.counts | counts)
    return MatchesWithRims(all_segments, with_rows(extended, tracks, rows), tracks.kept)


def _assign_rims(chords: Chords, circles: Circles, tuning: RimTuning) -> Int[np.ndarray, "n"]:
    """Return the rim that each segment is a chord of, (n,); -1 if none.

    If a segment lies on several rims, the nearest rim is returned.
    """
    if len(circles.radius_mm) == 0:
        return np.full(len(chords.view), -1)
    offsets = circle_offsets(chords, circles)
    largest_offset = np.abs(offsets.offset_px[..., ON_ARC]).max(axis=2)
    largest_offset = np.where(
        are_touching(offsets, tuning.touch_px, tuning), largest_offset, np.inf
    )
    return np.where(np.isfinite(largest_offset.min(axis=0)), largest_offset.argmin(axis=0), -1)
