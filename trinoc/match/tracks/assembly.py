"""From what was selected to tracks: fragments, lines in space with covariance, and reasons."""

import numpy as np
from jaxtyping import Int

from trinoc.match.evidence import probability
from trinoc.match.observations import MatchInput, distorted
from trinoc.match.occlusion import Pairs
from trinoc.match.selection import Selection, Tracks
from trinoc.match.tracks.fragments import ending_view, fragments_of
from trinoc.match.tracks.line_fit import lines_in_space
from trinoc.match.tracks.location import before_cameras, direction_doubt
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tracks.notes import notes_of
from trinoc.match.tracks.rejection import counted, reasons
from trinoc.match.tracks.viewpoint import flag_viewpoint_dependent
from trinoc.match.tuning import DEFAULT, MatchTuning, TrackTuning


def assemble(
    seen: MatchInput,
    tracks: Tracks,
    selections: list[Selection],
    pairs: Pairs,
    outside: Int[np.ndarray, "o v"],
    names: tuple[str, ...],
    noise_scale: float = 1.0,
    rules: MatchTuning = DEFAULT,
) -> Matches:
    """Matches in the caller's order of views and numbers of segments.

    `seen` holds covariances that are `noise_scale` times as large, in standard deviations, as
    stated, `outside` the segments of triples that the depth range excluded, or that lie behind a
    camera. Tracks that no pair of views can locate are left out, and their segments say so.
    """
    tuning, taken = rules.tracks, pairs.take(pairs.taken)
    index = np.concatenate([tracks.candidates.index, taken.candidates.index])
    interval = np.concatenate([tracks.candidates.interval, taken.candidates.interval])
    posterior_log_odds = np.concatenate([tracks.posterior_log_odds, taken.posterior_log_odds])
    rival_posterior = np.concatenate([tracks.rival_posterior, np.full(len(taken.taken), -np.inf)])
    common_mm = np.concatenate([tracks.candidates.ends_mm, taken.candidates.ends_mm])
    doubt = direction_doubt(seen.lines, index)
    located = doubt < tuning.largest_direction_doubt
    unlocated = index[~located]
    ends_here = ending_view(seen, index, common_mm)
    fragments, covariance = fragments_of(seen, index, interval, ends_here)
    ends_mm, covariance_mm2, misfit = lines_in_space(seen, index, common_mm)
    covariance_mm2 = covariance_mm2 * (1 + tuning.second_order * doubt**2)[:, None, None]
    sound = np.isfinite(ends_mm).all(axis=(1, 2)) & np.isfinite(covariance_mm2).all(axis=(1, 2))
    sound &= located & before_cameras(seen.lines, index, ends_mm)
    index, posterior_log_odds, rival_posterior = (
        index[sound],
        posterior_log_odds[sound],
        rival_posterior[sound],
    )
    fragments, covariance = fragments[sound], covariance[sound]
    ends_mm, covariance_mm2, misfit = ends_mm[sound], covariance_mm2[sound], misfit[sound]
    viewpoint_dependent = flag_viewpoint_dependent(seen, index, ends_mm, misfit, tuning)
    given = np.full(index.shape, -1)
    for view in range(len(names)):
        on = index[:, view] >= 0
        given[on, view] = seen.order[view][index[on, view]]
        fragments[on, view] = distorted(seen.intrinsics[view], fragments[on, view])
    turn = [seen.names.index(name) for name in names]
    given, fragments, covariance = given[:, turn], fragments[:, turn], covariance[:, turn]
    sort = np.lexsort((*fragments[:, :, 0].reshape(-1, 2 * len(names)).T, *given.T[::-1]))
    why = _reasons(seen, selections, pairs, outside, unlocated, index, tuning)
    counts = {
        "triples considered": sum(len(s.candidates.index) for s in selections),
        "triples outside depth": len(outside),
        "tracks in three views or more": len(tracks.posterior_log_odds),
        "pairs considered": len(pairs.candidates.index),
        "tracks in two views": int(pairs.taken.sum()),
        "tracks along the epipolar lines": len(unlocated),
        "tracks that seem to move with the viewpoint": int(viewpoint_dependent.sum()),
    }
    return Matches(
        names,
        given[sort],
        fragments[sort],
        ends_mm[sort],
        covariance_mm2[sort],
        np.where((given >= 0).sum(axis=1) > 2, TRINOCULAR, BINOCULAR)[sort],
        probability(posterior_log_odds)[sort],
        probability(rival_posterior)[sort],
        {name: why[name] for name in names},
        counts | counted(why),
        covariance[sort],
        misfit[sort],
        viewpoint_dependent[sort],
        noise_scale,
        notes_of(seen.lines, len(unlocated), noise_scale, rules.noise),
    )


def _reasons(
    seen: MatchInput,
    selections: list[Selection],
    pairs: Pairs,
    outside: Int[np.ndarray, "o v"],
    unlocated: Int[np.ndarray, "u v"],
    index: Int[np.ndarray, "t v"],
    tuning: TrackTuning,
) -> dict[str, np.ndarray]:
    running = [*selections, pairs]
    candidate = np.concatenate([found.candidates.index for found in running])
    log_odds = np.concatenate([found.log_odds for found in running])
    found = {}
    for view, name in enumerate(seen.names):
        excluded, along, matched, missed = np.zeros((4, seen.counts[view]), dtype=bool)
        matched[index[index[:, view] >= 0, view]] = True
        excluded[outside[outside[:, view] >= 0, view]] = True
        along[unlocated[unlocated[:, view] >= 0, view]] = True
        turned = (pairs.log_odds <= 0) & (pairs.log_odds > pairs.missed)
        owner = pairs.candidates.index[turned, view]
        missed[owner[owner >= 0]] = True
        words = reasons(candidate[:, view], log_odds, excluded, along, matched, missed, tuning)
        found[name] = np.empty_like(words)
        found[name][seen.order[view]] = words
    return found
