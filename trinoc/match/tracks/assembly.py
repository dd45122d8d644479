"""From what was selected to tracks: fragments, lines in space with covariance, and reasons."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.match.evidence import probability
from trinoc.match.observations import FrameInput, MatchInput, distorted, frames_of
from trinoc.match.occlusion import Pairs
from trinoc.match.selection import Selection, Tracks
from trinoc.match.tracks.fragments import ending_view, fragments_of
from trinoc.match.tracks.line_fit import lines_in_space
from trinoc.match.tracks.location import before_cameras, direction_doubt
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tracks.notes import notes_of
from trinoc.match.tracks.rejection import counted, reasons
from trinoc.match.tracks.unequal_errors import (
    degrees_of_misfit,
    learned_tail,
    scaled_across,
    variance_factor,
)
from trinoc.match.tracks.viewpoint import flag_viewpoint_dependent
from trinoc.match.tuning import DEFAULT, MatchTuning, NoiseTuning, TrackTuning
from trinoc.numerics import take_rows


class _Lines(NamedTuple):
    """Tracks of all frames, by the matcher's own numbers of segments and order of views."""

    index: Int[np.ndarray, "t v"]
    fragments_px: Float[np.ndarray, "t v 2 2"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    posterior_log_odds: Float[np.ndarray, "t"]
    rival_posterior: Float[np.ndarray, "t"]
    fragments_covariance_px2: Float[np.ndarray, "t v 4 4"]
    misfit: Float[np.ndarray, "t"]
    viewpoint_dependent: Bool[np.ndarray, "t"]


def assemble(
    seen: MatchInput,
    tracks: Tracks,
    selections: list[Selection],
    pairs: Pairs,
    outside: Int[np.ndarray, "o v"],
    names: Sequence[tuple[str, ...]],
    noise_scale: Float[np.ndarray, "f"],
    rules: MatchTuning = DEFAULT,
) -> list[Matches]:
    """Matches of each frame, in the caller's order of views (`names`) and numbers of segments.

    `seen` holds covariances that are `noise_scale` times as large, in standard deviations, as
    stated, `outside` the segments of triples that the depth range excluded, or that lie behind a
    camera. Tracks that no pair of views can locate are left out, and their segments say so.
    """
    found, unlocated = _lines(seen, tracks, pairs.take(pairs.taken), rules.tracks)
    words = _reasons(seen, selections, pairs, outside, unlocated, found.index, rules.tracks)
    of_each = {
        "triples considered": [selection.candidates.index for selection in selections],
        "triples outside depth": [outside],
        "tracks in three views or more": [tracks.candidates.index],
        "pairs considered": [pairs.candidates.index],
        "tracks in two views": [pairs.candidates.index[pairs.taken]],
        "tracks along the epipolar lines": [unlocated],
        "tracks that seem to move with the viewpoint": [found.index[found.viewpoint_dependent]],
    }
    counts = {name: _of_each_frame(seen, groups) for name, groups in of_each.items()}
    frame = frames_of(seen.lines, found.index)
    each = np.zeros(len(found.index), np.int64) if frame is None else frame
    order = np.argsort(each, kind="stable")
    bounds = np.searchsorted(each[order], np.arange(len(seen.frames) + 1))
    starts, results = seen.starts, []
    for number, own in enumerate(seen.frames):
        rows = take_rows(found, order[bounds[number] : bounds[number + 1]])
        said = [view[starts[number, v] : starts[number + 1, v]] for v, view in enumerate(words)]
        numbers = {name: int(of_frames[number]) for name, of_frames in counts.items()}
        notes = notes_of(
            own.cameras.centre_mm,
            numbers["tracks along the epipolar lines"],
            float(noise_scale[number]),
            rules.noise,
        )
        rows, tail = _with_unequal_errors(rows, own, rules.noise)
        noise = float(noise_scale[number]), tail
        results.append(
            _matches(own, starts[number], rows, said, numbers, names[number], noise, notes)
        )
    return results


def _with_unequal_errors(
    rows: _Lines, own: FrameInput, tuning: NoiseTuning
) -> tuple[_Lines, float]:
    """(lines whose covariances allow for errors that differ from track to track, their tail)."""
    degrees = degrees_of_misfit(rows.index)
    sure = (degrees > 0) & (probability(rows.posterior_log_odds) > tuning.sure)
    of_pictures = any(np.isfinite(levels).any() for levels in own.sides)
    tail = learned_tail(rows.misfit[sure], degrees[sure], of_pictures=of_pictures, tuning=tuning)
    factor = variance_factor(rows.misfit, degrees, tail)
    covariance = scaled_across(rows.ends_mm, rows.covariance_mm2, factor)
    return rows._replace(covariance_mm2=covariance), tail


def _of_each_frame(seen: MatchInput, groups: list[np.ndarray]) -> Int[np.ndarray, "f"]:
    """How many groups of segments there are in each frame."""
    frames = [frames_of(seen.lines, index) for index in groups]
    labels = [
        np.zeros(len(index), np.int64) if frame is None else frame
        for frame, index in zip(frames, groups, strict=True)
    ]
    every = np.concatenate([np.zeros(0, np.int64), *labels])
    return np.bincount(every, minlength=len(seen.frames))


def _lines(
    seen: MatchInput, tracks: Tracks, taken: Pairs, tuning: TrackTuning
) -> tuple[_Lines, Int[np.ndarray, "u v"]]:
    """(lines in space, segments of tracks that no pair of views can locate)."""
    index = np.concatenate([tracks.candidates.index, taken.candidates.index])
    interval = np.concatenate([tracks.candidates.interval, taken.candidates.interval])
    posterior_log_odds = np.concatenate([tracks.posterior_log_odds, taken.posterior_log_odds])
    rival_posterior = np.concatenate([tracks.rival_posterior, np.full(len(taken.taken), -np.inf)])
    common_mm = np.concatenate([tracks.candidates.ends_mm, taken.candidates.ends_mm])
    doubt = direction_doubt(seen.lines, index)
    located = doubt < tuning.largest_direction_doubt
    ends_here = ending_view(seen, index, common_mm)
    fragments, covariance = fragments_of(seen, index, interval, ends_here)
    ends_mm, covariance_mm2, misfit = lines_in_space(seen, index, common_mm)
    covariance_mm2 = covariance_mm2 * (1 + tuning.second_order * doubt**2)[:, None, None]
    sound = np.isfinite(ends_mm).all(axis=(1, 2)) & np.isfinite(covariance_mm2).all(axis=(1, 2))
    sound &= located & before_cameras(seen.lines, index, ends_mm)
    every = _Lines(
        index,
        fragments,
        ends_mm,
        covariance_mm2,
        posterior_log_odds,
        rival_posterior,
        covariance,
        misfit,
        np.zeros(len(index), dtype=bool),
    )
    found = take_rows(every, sound)
    dependent = flag_viewpoint_dependent(seen, found.index, found.ends_mm, found.misfit, tuning)
    return found._replace(viewpoint_dependent=dependent), index[~located]


def _matches(
    own: FrameInput,
    start: Int[np.ndarray, "v"],
    rows: _Lines,
    words: list[Shaped[np.ndarray, "_"]],
    counts: dict[str, int],
    names: tuple[str, ...],
    noise: tuple[float, float],
    notes: tuple[str, ...],
) -> Matches:
    """The answer of one frame, whose segments begin at `start` in the tables; `noise` is its scale
    and its tail."""
    given = np.full(rows.index.shape, -1)
    fragments, why = rows.fragments_px, {}
    for view, name in enumerate(own.names):
        on = np.flatnonzero(rows.index[:, view] >= 0)
        given[on, view] = own.order[view][rows.index[on, view] - start[view]]
        fragments[on, view] = distorted(own.cameras.intrinsics[view], fragments[on, view])
        why[name] = np.empty_like(words[view])
        why[name][own.order[view]] = words[view]
    turn = [own.names.index(name) for name in names]
    given, fragments = given[:, turn], fragments[:, turn]
    sort = np.lexsort((*fragments[:, :, 0].reshape(-1, 2 * len(names)).T, *given.T[::-1]))
    return Matches(
        names,
        given[sort],
        fragments[sort],
        rows.ends_mm[sort],
        rows.covariance_mm2[sort],
        np.where((given >= 0).sum(axis=1) > 2, TRINOCULAR, BINOCULAR)[sort],
        probability(rows.posterior_log_odds)[sort],
        probability(rows.rival_posterior)[sort],
        {name: why[name] for name in names},
        counts | counted(why),
        rows.fragments_covariance_px2[:, turn][sort],
        rows.misfit[sort],
        rows.viewpoint_dependent[sort],
        noise[0],
        notes,
        noise_tail=noise[1],
    )


def _reasons(
    seen: MatchInput,
    selections: list[Selection],
    pairs: Pairs,
    outside: Int[np.ndarray, "o v"],
    unlocated: Int[np.ndarray, "u v"],
    index: Int[np.ndarray, "t v"],
    tuning: TrackTuning,
) -> list[Shaped[np.ndarray, "_"]]:
    running = [*selections, pairs]
    candidate = np.concatenate([found.candidates.index for found in running])
    log_odds = np.concatenate([found.log_odds for found in running])
    words = []
    for view, count in enumerate(seen.counts):
        excluded, along, matched, missed = np.zeros((4, count), dtype=bool)
        matched[index[index[:, view] >= 0, view]] = True
        excluded[outside[outside[:, view] >= 0, view]] = True
        along[unlocated[unlocated[:, view] >= 0, view]] = True
        turned = (pairs.log_odds <= 0) & (pairs.log_odds > pairs.missed)
        owner = pairs.candidates.index[turned, view]
        missed[owner[owner >= 0]] = True
        words.append(
            reasons(candidate[:, view], log_odds, excluded, along, matched, missed, tuning)
        )
    return words
