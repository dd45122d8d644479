"""Segments and tracks while pictures are asked again: tables that grow."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.intrinsics import Intrinsics, undistort_pixels
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.observations.match_input import (
    CamerasInput,
    FrameInput,
    MatchInput,
    prepare,
    stack_frames,
    with_noise_scale,
)
from trinoc.match.observations.side_intensity import SIDE_COLUMNS
from trinoc.match.tracks.line_fit import common_ends, lines_in_space, segment_reaches
from trinoc.match.tracks.matches import Matches


class ViewSegments(NamedTuple):
    """Segments of one view, undistorted: the caller's, and after them those that were added.

    ends_px : (n, 2, 2). covariance_px2 : (n, 4, 4), of the errors found.
    contrast : (n,) grey levels, with a sign: positive where it is brighter on the right.
    guided : (n,) whether one was added, or lengthened, by guided detection.
    """

    ends_px: Float[np.ndarray, "n 2 2"]
    covariance_px2: Float[np.ndarray, "n 4 4"]
    contrast: Float[np.ndarray, "n"]
    guided: Bool[np.ndarray, "n"]


class GuidedTracks(NamedTuple):
    """Tracks with the segment of each view, and what is known of their lines.

    index : (t, v). near_mm : (t, 2, 3) two places on each line. log_odds : (t,) posterior.
    ends_mm, covariance_mm2, misfit : of what two views show, see `lines_in_space`.
    reach : (t, v, 2) where every view's segment begins and ends, 0 and 1 at `ends_mm`.
    """

    index: Int[np.ndarray, "t v"]
    log_odds: Float[np.ndarray, "t"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    misfit: Float[np.ndarray, "t"]
    reach: Float[np.ndarray, "t v 2"]


class State(NamedTuple):
    """Everything of one frame; a changed state is a new one."""

    names: tuple[str, ...]
    cameras: CamerasInput
    segments: tuple[ViewSegments, ...]
    tracks: GuidedTracks


def initial_state(matches: Matches, segments: Mapping[str, Segments], rig: Rig) -> State:
    """The state before any picture is asked again."""
    given = {name: segments[name] for name in matches.views}
    seen = with_noise_scale(prepare(given, rig, None), np.array([matches.noise_scale]))
    views = []
    for name in matches.views:
        view = seen.names.index(name)
        back = np.argsort(seen.order[view])
        own = given[name]
        # The order of a segment's ends is that of the tables, which is theirs or turned round.
        turn = ends_are_swapped(seen.ends_px[view][back], rig[name].intrinsics, own)
        darker = np.where(turn, -1.0, 1.0) * np.asarray(own.polarity)
        height = np.nan_to_num(np.abs(np.asarray(own.contrast)))
        views.append(
            ViewSegments(
                seen.ends_px[view][back],
                seen.covariance_px2[view][back],
                -darker * height,
                np.zeros(len(back), dtype=bool),
            )
        )
    p = np.clip(matches.posterior, 1e-9, 1 - 1e-9)
    tracks = GuidedTracks(
        matches.index,
        np.log(p) - np.log1p(-p),
        matches.lines_mm,
        matches.covariance_mm2,
        np.zeros(len(p)) if matches.misfit is None else matches.misfit,
        np.zeros((*matches.index.shape, 2)),
    )
    cameras = seen.frames[0].cameras.take([seen.names.index(name) for name in matches.views])
    state = State(matches.views, cameras, tuple(views), tracks)
    return refit_tracks(state, tracks)


def ends_are_swapped(
    table_px: Float[np.ndarray, "n 2 2"], lens: Intrinsics, given: Segments
) -> Bool[np.ndarray, "n"]:
    """Whether the tables hold the ends of the caller's segments in the other order."""
    first = undistort_pixels(lens, np.asarray(given.endpoints_px))[:, 0]
    return (table_px[:, 0] != first).any(axis=1)


def build_tables(state: State) -> MatchInput:
    """The segments as the matcher's tables, numbered as here."""
    counts = [len(view.ends_px) for view in state.segments]
    return stack_frames(
        [
            FrameInput(
                state.names,
                [np.arange(count) for count in counts],
                [view.ends_px for view in state.segments],
                [view.covariance_px2 for view in state.segments],
                [np.zeros(count, dtype=np.int64) for count in counts],
                [np.full((count, SIDE_COLUMNS), np.nan) for count in counts],
                state.cameras,
                [np.full(count, "") for count in counts],
            )
        ]
    )


def refit_tracks(state: State, tracks: GuidedTracks) -> State:
    """With these tracks, whose lines are fitted anew to their segments."""
    if len(tracks.index) == 0:
        return state._replace(tracks=tracks)
    seen = build_tables(state)
    common = common_ends(seen, tracks.index, tracks.ends_mm)
    ends, covariance, misfit = lines_in_space(seen, tracks.index, common)
    finite = np.isfinite(ends).all(axis=(1, 2)) & np.isfinite(covariance).all(axis=(1, 2))
    sound = np.asarray(finite)[:, None, None]
    ends = np.where(sound, ends, tracks.ends_mm)
    covariance = np.where(sound, covariance, tracks.covariance_mm2)
    reach = segment_reaches(seen, tracks.index, ends)
    return state._replace(
        tracks=GuidedTracks(tracks.index, tracks.log_odds, ends, covariance, misfit, reach)
    )


def with_segments(
    state: State, view: int, ends_px: np.ndarray, covariance_px2: np.ndarray, contrast: np.ndarray
) -> State:
    """With further segments of a view, at the end of its table."""
    own = state.segments[view]
    more = ViewSegments(
        np.concatenate([own.ends_px, ends_px]),
        np.concatenate([own.covariance_px2, covariance_px2]),
        np.concatenate([own.contrast, contrast]),
        np.concatenate([own.guided, np.ones(len(ends_px), dtype=bool)]),
    )
    return with_view(state, view, more)


def with_view(state: State, view: int, segments: ViewSegments) -> State:
    """With another table of one view."""
    views: Sequence[ViewSegments] = [
        segments if k == view else own for k, own in enumerate(state.segments)
    ]
    return state._replace(segments=tuple(views))
