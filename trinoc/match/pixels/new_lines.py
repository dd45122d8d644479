"""New lines: those of the hypotheses that two pictures or more show.

First comes a quick look, far cheaper than the one test: the gradient across is read at LOOKS
places along, from the nearest pixels, on five lines side by side. Where most of it goes along the
probe, it is that of an edge that crosses, and does not count.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.intrinsics import distort_pixels
from trinoc.geometry.projection import project_by_matrix
from trinoc.match.pixels.joint import Proposals, propose_lines, query_pictures
from trinoc.match.pixels.partners import (
    Hypotheses,
    joined_ends,
    locate_corners,
    mm_per_px,
    propose_partners,
)
from trinoc.match.pixels.probes import REACH
from trinoc.match.pixels.state import GuidedTracks, State, refit_tracks, with_segments
from trinoc.match.pixels.views import PictureInput
from trinoc.match.tuning.guided import GuidedTuning
from trinoc.numerics.tables import concatenate_rows, take_rows

# numerical: places of a quick look along a line, for time.
LOOKS = 16
# numerical: probes at once; OpenCV takes 32,766 rows at most.
_AT_ONCE = 2048
# numerical: lines are drawn with their ends in so many binary digits of a pixel.
_DIGITS = 4


def with_new_lines(
    state: State, pictures: list[PictureInput], tuning: GuidedTuning
) -> tuple[State, int]:
    """(the state with new tracks, how many)."""
    ends = joined_ends(state, tuning)
    if len(ends.place_mm) == 0:
        return state, 0
    hypotheses = propose_partners(state, ends, locate_corners(state, ends, tuning), tuning)
    promising = _promising(state, pictures, hypotheses.ends_mm, tuning)
    if not promising.any():
        return state, 0
    hypotheses = take_rows(hypotheses, promising)
    found = query_pictures(pictures, hypotheses.ends_mm, hypotheses.covariance_mm2, tuning)
    return with_accepted(
        state, propose_lines(state, found, hypotheses, len(promising), tuning), tuning
    )


def _promising(
    state: State,
    pictures: list[PictureInput],
    lines_mm: Float[np.ndarray, "n 2 3"],
    tuning: GuidedTuning,
) -> Bool[np.ndarray, "n"]:
    """Whether two pictures may show each line, apart from what shows matched lines already."""
    rest = []
    for view, picture in enumerate(pictures):
        used = np.unique(state.tracks.index[:, view])
        matched = state.segments[view].ends_px[used[used >= 0]]
        rest.append(mask_segments(picture, matched, 2 * REACH + 1))
    return (_looks(rest, lines_mm) > tuning.plausible_sigmas).sum(axis=1) >= 2


def _looks(
    pictures: list[PictureInput], lines_mm: Float[np.ndarray, "n 2 3"]
) -> Float[np.ndarray, "n v"]:
    """A quick look at every line in every picture."""
    images = [project_by_matrix(picture.matrix_px, lines_mm) for picture in pictures]
    looks = [quick_look(*both) for both in zip(pictures, images, strict=True)]
    return np.stack(looks, axis=1)


def quick_look(
    picture: PictureInput, ends_px: Float[np.ndarray, "n 2 2"]
) -> Float[np.ndarray, "n"]:
    """Mean of the gradient across along the better half of each probe, in standard deviations of
    its noise; without sign."""
    found = np.zeros(len(ends_px))
    for start in range(0, len(ends_px), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        found[rows] = _sample_mask(picture, ends_px[rows])
    return found


def _sample_mask(
    picture: PictureInput, ends_px: Float[np.ndarray, "n 2 2"]
) -> Float[np.ndarray, "n"]:
    ends_px = distort_pixels(picture.lens, ends_px)
    way = ends_px[:, 1] - ends_px[:, 0]
    unit = way / np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    along, beside = (np.arange(LOOKS) + 0.5) / LOOKS, np.arange(-REACH, REACH + 1)
    u, v = (
        (start[:, None] + along * step[:, None])[:, None] + beside[:, None] * side[:, None, None]
        for start, step, side in zip(ends_px[:, 0].T, way.T, right.T, strict=True)
    )
    u, v = (place.reshape(len(way), LOOKS * len(beside)).astype(np.float32) for place in (u, v))
    by_u, by_v = (
        cv2.remap(of, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        for of in picture.by_uv
    )
    noise = max(picture.noise, 1e-3)
    across, crossing = (
        by_u * side[:, :1] + by_v * side[:, 1:]
        for side in ((axis / noise).astype(np.float32) for axis in (right, unit))
    )
    across = np.where(np.abs(crossing) < np.abs(across), across, 0.0)
    quarters = across.reshape(len(way), len(beside), 4, LOOKS // 4).sum(axis=3)
    halves = np.abs(quarters[..., :-1] + quarters[..., 1:])
    return halves.max(axis=(1, 2), initial=0.0) / (LOOKS // 2)


def mask_segments(
    picture: PictureInput, ends_px: Float[np.ndarray, "n 2 2"], width_px: int
) -> PictureInput:
    """The picture with no gradient on these segments: what is left is new."""
    by_uv = picture.by_uv.copy()
    places = np.rint(distort_pixels(picture.lens, ends_px) * 2**_DIGITS).astype(np.int32)
    for of in by_uv:
        cv2.polylines(of, list(places), False, 0.0, width_px, cv2.LINE_8, _DIGITS)
    return picture._replace(by_uv=by_uv)


# numerical: an index of nothing.
NONE = -1


class EdgeKnowledge(NamedTuple):
    """Of each edge found in a view.

    segment : (n,) the segment that shows the same, or NONE.
    track : (n,) the track that shows the same part of this view, or NONE.
    """

    segment: Int[np.ndarray, "n"]
    track: Int[np.ndarray, "n"]


def edge_knowledge(
    state: State, view: int, ends_px: Float[np.ndarray, "n 2 2"], tuning: GuidedTuning
) -> EdgeKnowledge:
    """What is known of edges found in a view."""
    segments = state.segments[view].ends_px
    shared = overlap_shares(ends_px, segments, tuning.same_px)
    segment = _best(shared, tuning.same_overlap)
    on = np.flatnonzero(state.tracks.index[:, view] >= 0)
    image = project_by_matrix(state.cameras.matrix_px[view], state.tracks.ends_mm[on])
    parts = overlap_shares(ends_px, image, tuning.same_px)
    track = _best(parts, tuning.same_overlap)
    return EdgeKnowledge(segment, np.where(track >= 0, on[track] if len(on) else NONE, NONE))


def overlap_shares(
    ends_px: Float[np.ndarray, "n 2 2"], others_px: Float[np.ndarray, "m 2 2"], near_px: float
) -> Float[np.ndarray, "n m"]:
    """Share of the shorter that two segments have in common; 0 where they are not one line."""
    way = ends_px[:, 1] - ends_px[:, 0]
    length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    unit = way / length[:, None]
    off = others_px[None] - ends_px[:, None, :1]
    along = np.sort(np.einsum("nmei,ni->nme", off, unit), axis=2)
    across = np.einsum("nmei,ni->nme", off, np.stack([-unit[:, 1], unit[:, 0]], axis=1))
    raw = np.einsum("nmei,ni->nme", off, unit)
    step = raw[..., 1] - raw[..., 0]
    step = np.where(np.abs(step) > 1e-6, step, 1e-6)
    # The other line abreast of the ends of what both share.
    low = np.maximum(along[..., 0], 0.0)
    high = np.minimum(along[..., 1], length[:, None])
    slope = (across[..., 1] - across[..., 0]) / step
    at = [across[..., 0] + slope * (place - raw[..., 0]) for place in (low, high)]
    one = (high > low) & (np.abs(at[0]) < near_px) & (np.abs(at[1]) < near_px)
    size = np.minimum(length[:, None], along[..., 1] - along[..., 0])
    return np.where(one, (high - low) / np.maximum(size, 1e-9), 0.0)


def _best(shared: Float[np.ndarray, "n m"], least: float) -> Int[np.ndarray, "n"]:
    if shared.shape[1] == 0:
        return np.full(len(shared), NONE)
    best = shared.argmax(axis=1)
    return np.where(shared[np.arange(len(best)), best] >= least, best, NONE)


def with_accepted(state: State, proposals: Proposals, tuning: GuidedTuning) -> tuple[State, int]:
    """(the state with new tracks, how many)."""
    free = take_rows(proposals, ~_are_on_tracks(state, proposals, tuning))
    count = 0
    for row in range(len(free.log_odds)):
        one = take_rows(free, np.array([row]))
        # What was added just now is taken, too.
        if count and _are_on_tracks(state, one, tuning).any():
            continue
        grown, new = _try_line(state, one, tuning)
        if new.misfit[0] > tuning.gate or not _is_where_sought(grown, new, one.asked_for, tuning):
            continue
        state = grown._replace(tracks=concatenate_rows([state.tracks, new]))
        count += 1
    return state, count


def _are_on_tracks(
    state: State, proposals: Proposals, tuning: GuidedTuning
) -> Bool[np.ndarray, "n"]:
    """Whether a track shows any of a line's edges already."""
    claimed = np.zeros(len(proposals.log_odds), dtype=bool)
    for view, answer in enumerate(proposals.answers):
        on = np.flatnonzero(proposals.members[:, view])
        claimed[on] |= edge_knowledge(state, view, answer.ends_px[on], tuning).track >= 0
    return claimed


def _try_line(state: State, one: Proposals, tuning: GuidedTuning) -> tuple[State, GuidedTracks]:
    """(the segments with the edges of one line, its track)."""
    index = np.full((1, one.members.shape[1]), NONE)
    for view in np.flatnonzero(one.members[0]).tolist():
        answer = one.answers[view]
        index[0, view] = edge_knowledge(state, view, answer.ends_px, tuning).segment[0]
        if index[0, view] == NONE:
            index[0, view] = len(state.segments[view].ends_px)
            contrast = answer.sign * answer.contrast
            state = with_segments(state, view, answer.ends_px, answer.covariance_px2, contrast)
    track = _unlocated_track(index, one.log_odds, one.asked_for.ends_mm)
    return state, refit_tracks(state._replace(tracks=track), track).tracks


def _unlocated_track(
    index: Int[np.ndarray, "1 v"],
    log_odds: Float[np.ndarray, "1"],
    line_mm: Float[np.ndarray, "1 2 3"],
) -> GuidedTracks:
    """A track whose line is where it was asked for."""
    unknown = np.zeros((1, 6, 6)), np.zeros(1), np.zeros((*index.shape, 2))
    return GuidedTracks(index, log_odds, line_mm, *unknown)


def _is_where_sought(
    state: State, new: GuidedTracks, asked_for: Hypotheses, tuning: GuidedTuning
) -> bool:
    """Whether a new line lies as near to where it was asked for as ends that meet."""
    begin, end = asked_for.ends_mm[0]
    off = new.ends_mm[0] - begin
    across = np.linalg.norm(np.cross(off, (end - begin) / np.linalg.norm(end - begin)), axis=1)
    return bool((across < tuning.meet_px * mm_per_px(state, new.ends_mm[0])).all())
