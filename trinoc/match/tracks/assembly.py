"""From what was selected to tracks: fragments, lines in space with covariance, and reasons."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.match.observations import MatchInput, frames_of
from trinoc.match.occlusion import Pairs
from trinoc.match.selection import Selection, Tracks
from trinoc.match.tracks.answers import UNLOCATED, Lines, answers, reasons
from trinoc.match.tracks.extent import reach_of
from trinoc.match.tracks.fragments import ending_at, fragments_of
from trinoc.match.tracks.line_fit import before_cameras, direction_doubt, lines_in_space
from trinoc.match.tracks.matches import Matches
from trinoc.match.tracks.viewpoint import flag_viewpoint_dependent
from trinoc.match.tuning import DEFAULT, MatchTuning, TrackTuning
from trinoc.numerics import take_rows


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
        UNLOCATED: [unlocated],
        "tracks that seem to move with the viewpoint": [found.index[found.viewpoint_dependent]],
    }
    counts = {name: _of_each_frame(seen, groups) for name, groups in of_each.items()}
    frame = frames_of(seen.lines, found.index)
    each = np.zeros(len(found.index), np.int64) if frame is None else frame
    return answers(seen, found, each, words, counts, names, noise_scale, rules.noise)


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
) -> tuple[Lines, Int[np.ndarray, "u v"]]:
    """(lines in space, segments of tracks that no pair of views can locate)."""
    index = np.concatenate([tracks.candidates.index, taken.candidates.index])
    interval = np.concatenate([tracks.candidates.interval, taken.candidates.interval])
    posterior_log_odds = np.concatenate([tracks.posterior_log_odds, taken.posterior_log_odds])
    rival_posterior = np.concatenate([tracks.rival_posterior, np.full(len(taken.taken), -np.inf)])
    common_mm = np.concatenate([tracks.candidates.ends_mm, taken.candidates.ends_mm])
    doubt = direction_doubt(seen.lines, index)
    located = doubt < tuning.largest_direction_doubt
    reach = reach_of(seen, index, common_mm)
    ends_here = ending_at(reach, np.array([0.0, 1.0]))
    fragments, covariance = fragments_of(seen, index, interval, ends_here)
    ends_mm, covariance_mm2, misfit = lines_in_space(seen, index, common_mm, reach)
    covariance_mm2 = covariance_mm2 * (1 + tuning.second_order * doubt**2)[:, None, None]
    sound = np.isfinite(ends_mm).all(axis=(1, 2)) & np.isfinite(covariance_mm2).all(axis=(1, 2))
    sound &= located & before_cameras(seen.lines, index, ends_mm)
    every = Lines(
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
