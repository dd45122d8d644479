"""From tables that have grown back to the caller's values: segments and matches."""

import dataclasses

import numpy as np

from trinoc.geometry import Segments
from trinoc.match.guided.state import State, tables_of, turned_round
from trinoc.match.observations import distorted
from trinoc.match.tracks import (
    BINOCULAR,
    TRINOCULAR,
    Matches,
    common_ends,
    degrees_of_misfit,
    ending_view,
    flag_viewpoint_dependent,
    fragments_of,
    interval_of,
    scaled_across,
    variance_factor,
)
from trinoc.match.tuning import MatchTuning

MATCHED = "matched"


def segments_of(before: State, after: State, given: dict[str, Segments]) -> dict[str, Segments]:
    """The segments of each view: those that were given, some longer, and those that were added."""
    return {
        name: _of_view(before, after, view, given[name]) for view, name in enumerate(after.names)
    }


def _of_view(before: State, after: State, view: int, given: Segments) -> Segments:
    old, now = before.segments[view], after.segments[view]
    count = len(given)
    changed = np.flatnonzero(now.guided[:count])
    lens = after.cameras.intrinsics[view]
    if len(changed) == 0 and len(now.ends_px) == count:
        return given
    ends, covariance = distorted(lens, now.ends_px), now.covariance_px2
    back = turned_round(old.ends_px, lens, given)
    turn = np.concatenate([back, np.zeros(len(now.ends_px) - count, dtype=bool)])
    ends = np.where(turn[:, None, None], ends[:, ::-1], ends)
    blocks = covariance.reshape(-1, 2, 2, 2, 2)
    blocks = np.where(turn[:, None, None, None, None], blocks[:, ::-1, :, ::-1], blocks)
    covariance = blocks.reshape(-1, 4, 4)
    keep = np.ones(len(ends), dtype=bool)
    keep[changed] = keep[count:] = False
    keep = keep[:count]
    height = now.contrast[len(old.contrast) :]
    longer = dataclasses.replace(
        given, endpoints_px=ends[:count], covariance_px2=covariance[:count]
    )
    added = Segments(
        ends[count:],
        covariance[count:],
        -np.sign(height).astype(np.int64),
        np.abs(height),
        np.zeros(len(height), dtype=np.int64),
        given.image_size_px,
    )
    return longer.followed_by(added)


def matches_of(after: State, given: Matches, added: dict[str, int], tuning: MatchTuning) -> Matches:
    """The given tracks, in their order, and after them the new ones."""
    tracks = after.tracks
    if len(tracks.index) == 0:
        return dataclasses.replace(given, counts=given.counts | added)
    seen = tables_of(after)
    common = common_ends(seen, tracks.index, tracks.ends_mm)
    here = ending_view(seen, tracks.index, common)
    interval = interval_of(seen, tracks.index, common)
    fragments, covariance = fragments_of(seen, tracks.index, interval, here)
    guided = np.zeros(tracks.index.shape, dtype=bool)
    for view, own in enumerate(after.segments):
        on = np.flatnonzero(tracks.index[:, view] >= 0)
        guided[on, view] = own.guided[tracks.index[on, view]]
        fragments[on, view] = distorted(after.cameras.intrinsics[view], fragments[on, view])
    new = len(tracks.index) - len(given)
    views = (tracks.index >= 0).sum(axis=1)
    factor = variance_factor(tracks.misfit, degrees_of_misfit(tracks.index), given.noise_tail)
    return Matches(
        given.views,
        tracks.index,
        fragments,
        tracks.ends_mm,
        scaled_across(tracks.ends_mm, tracks.covariance_mm2, factor),
        np.where(views > 2, TRINOCULAR, BINOCULAR),
        1 / (1 + np.exp(-tracks.log_odds)),
        np.concatenate([given.rival_posterior, np.zeros(new)]),
        {
            name: _reasons(given.reasons[name], tracks.index[:, view], len(own.ends_px))
            for view, (name, own) in enumerate(zip(after.names, after.segments, strict=True))
        },
        given.counts | added,
        covariance,
        np.where(views > 2, tracks.misfit, 0.0),
        flag_viewpoint_dependent(seen, tracks.index, tracks.ends_mm, tracks.misfit, tuning.tracks),
        given.noise_scale,
        given.notes,
        guided,
        noise_tail=given.noise_tail,
    )


def _reasons(words: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """The words on each segment, those that are on a track now "matched"."""
    longer = np.concatenate([words, np.full(count - len(words), MATCHED)])
    longer[index[index >= 0]] = MATCHED
    return longer
