"""What rims leave of matches: tracks that none explains, those of outlines below rims marked."""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.bodies.circles import ENDS, Chords, Circles
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.bodies import RimTuning
from trinoc.numerics.vectors import cross_3d


def are_outlines(
    chords: Chords, circles: Circles, mm_per_px: float, tuning: RimTuning
) -> Bool[np.ndarray, "n"]:
    """Whether the rays of a segment's ends touch the cylinder over any of the circles, near it."""
    found = np.zeros(len(chords.view), dtype=bool)
    rays = chords.rays[:, ENDS]
    for centre, axis, radius in zip(*circles, strict=True):
        across = cross_3d(rays, axis)
        sine = np.maximum(np.linalg.norm(across, axis=2), 1e-9)
        off = (chords.centre_mm - centre)[:, None]
        distance = np.abs((off * across).sum(axis=2)) / sine
        height = abs_height(rays, off, axis)
        near = np.abs(distance - radius).max(axis=1) < tuning.outline_px * mm_per_px
        begins = height.min(axis=1) < tuning.outline_from * radius
        # From the rim down: a line across it does not leave its plane.
        leaves = height.max(axis=1) - height.min(axis=1) > tuning.outline_px * mm_per_px
        found |= near & begins & leaves & (height.max(axis=1) < tuning.outline_to * radius)
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
    mark = np.where(held, tuning.outline_posterior, 0.0)[kept]
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
