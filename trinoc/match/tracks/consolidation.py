"""More than three views: tracks are tested as wholes, grown into views they lack, and joined.

Each track predicts its line in every view that it lacks. What it meets there belongs to no track,
and is added, or to another, and the two are joined: the nearest first, and only if the line of all
segments together is consistent. So every member is tested again at every step.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates.table import no_candidates
from trinoc.match.observations.match_input import MatchInput, with_noise_scale
from trinoc.match.selection.marginals import Selection, Tracks, take_tracks
from trinoc.match.tracks.assembly import typical_misfit
from trinoc.match.tracks.line_fit import (
    FittedTracks,
    before_cameras,
    common_part,
    consistent,
    fit_tracks,
    overlap_share,
    segment_position,
    split_off_misfits,
    track_intervals,
)
from trinoc.match.tracks.multiview import merge_triplets
from trinoc.match.tracks.predicted_segments import predict_segments
from trinoc.match.tracks.unequal_errors import degrees_of_misfit, fit_tail, misfit_limit
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.tables import concatenate_rows
from trinoc.numerics.tails import chi_square_tail

# numerical: nobody's segment.
FREE = -1


class _Proposal(NamedTuple):
    """To give a track a segment of another view, or all segments of the track that has it."""

    chi_square: float
    track: int
    view: int
    segment: int
    owner: int


def tracks_through_views(
    seen: MatchInput, selections: list[Selection], tuning: MatchTuning = DEFAULT
) -> tuple[Tracks, float]:
    """What was selected in each three of the views, joined where there are more than three, as
    `consolidate_tracks` gives it."""
    if not selections:
        nothing = no_candidates(len(seen.ends_px), seen.lines.frame is not None)
        return Tracks(nothing, np.zeros(0), np.zeros(0)), 1.0
    tracks = concatenate_rows([take_tracks(selection) for selection in selections])
    if len(selections) == 1:
        return tracks, 1.0
    return consolidate_tracks(seen, merge_triplets(seen.lines, tracks, tuning), tuning)


def consolidate_tracks(
    seen: MatchInput, tracks: Tracks, tuning: MatchTuning = DEFAULT
) -> tuple[Tracks, float]:
    """(tracks of which each is consistent, and as many views as agree are in each; how much larger
    errors are than `seen` states, in standard deviations).

    Of three views each camera's own error goes into the line: many views show it. So most tracks
    tell how large errors are. First these count as equal. What is then found tells how unequal they
    are from track to track, and what that allows is added.
    """
    now = fit_tracks(seen, tracks.candidates.index, tracks.candidates.ends_mm)
    larger = float(np.sqrt(typical_misfit(now.index, now.misfit, tuning.tracks)))
    seen = with_noise_scale(seen, np.array([larger]))
    now = fit_tracks(seen, now.index, now.common_mm)
    now = _grow(seen, split_off_misfits(seen, now, tuning), 0.0, tuning)
    on = (now.index >= 0).any(axis=1)
    tail = tail_of_tracks(now.index[on], now.misfit[on], tuning)
    now = _grow(seen, now, tail, tuning)
    on = (now.index >= 0).any(axis=1)
    return _as_tracks(seen, tracks, now).take(np.flatnonzero(on)), larger


def tail_of_tracks(
    index: Int[np.ndarray, "t v"], misfit: Float[np.ndarray, "t"], tuning: MatchTuning
) -> float:
    """How unequal errors are (`fit_tail`), as far as wrong tracks can be kept from saying it."""
    tail = fit_tail(misfit, degrees_of_misfit(index), of_pictures=False)
    return min(tail, tuning.tracks.largest_tail)


def _grow(
    seen: MatchInput, now: FittedTracks, noise_tail: float, tuning: MatchTuning
) -> FittedTracks:
    """Tracks with what they meet in the views that they lack; those that were joined to others
    hold no view."""
    significance = chi_square_tail(tuning.candidates.gate, 2)
    nearby = float(misfit_limit(significance, np.array(2), noise_tail))
    nearby = min(nearby, tuning.tracks.widest_gate)
    alive = np.asarray((now.index >= 0).any(axis=1))
    refused: set[tuple[int, ...]] = set()
    changed = alive.copy()
    proposals: dict[int, list[_Proposal]] = {}
    for _ in range(tuning.tracks.merge_rounds):
        proposals = {t: p for t, p in proposals.items() if alive[t] and not changed[t]}
        proposals |= _proposals(seen, now, np.flatnonzero(alive & changed), nearby, tuning)
        owners = _owners(seen, now, alive)
        trials = _disjoint(seen, now, alive, proposals, owners, refused, tuning)
        if not trials:
            break
        index = np.array([trial.index for trial in trials])
        common = np.array([trial.common_mm for trial in trials])
        attempt = fit_tracks(seen, index, common)
        good = consistent(seen, attempt, tuning, noise_tail)
        good &= before_cameras(seen.lines, index, attempt.ends_mm)
        changed = np.zeros(len(alive), dtype=bool)
        columns = [column.copy() for column in now]
        for row, trial in enumerate(trials):
            if not good[row]:
                refused.add(tuple(trial.index.tolist()))
                continue
            for column, new in zip(columns, attempt, strict=True):
                column[trial.track] = new[row]
            changed[trial.track] = True
            if trial.joined != FREE:
                alive[trial.joined] = False
        now = FittedTracks(*columns)
    return now._replace(index=np.where(alive[:, None], now.index, -1))


class _Trial(NamedTuple):
    track: int
    joined: int
    index: Int[np.ndarray, "v"]
    common_mm: Float[np.ndarray, "2 3"]


def _proposals(
    seen: MatchInput,
    now: FittedTracks,
    rows: Int[np.ndarray, "r"],
    gate: float,
    tuning: MatchTuning,
) -> dict[int, list[_Proposal]]:
    """What each of some tracks meets in the views that it lacks."""
    found: dict[int, list[_Proposal]] = {int(row): [] for row in rows}
    for view, count in enumerate(seen.counts):
        lacking = rows[now.index[rows, view] < 0]
        ends_mm, covariance_mm2 = now.ends_mm[lacking], now.covariance_mm2[lacking]
        hits = predict_segments(seen.lines, view, count, ends_mm, covariance_mm2, gate, tuning)
        for track, segment, chi_square in zip(*(column.tolist() for column in hits), strict=True):
            row = int(lacking[track])
            found[row].append(_Proposal(chi_square, row, view, segment, FREE))
    return found


def _owners(
    seen: MatchInput, now: FittedTracks, alive: np.ndarray
) -> dict[tuple[int, int], list[int]]:
    """The tracks that each segment is on."""
    owners: dict[tuple[int, int], list[int]] = {}
    for track in np.flatnonzero(alive).tolist():
        for view, segment in enumerate(now.index[track].tolist()):
            if segment >= 0:
                owners.setdefault((view, segment), []).append(track)
    return owners


def _disjoint(
    seen: MatchInput,
    now: FittedTracks,
    alive: np.ndarray,
    proposals: dict[int, list[_Proposal]],
    owners: dict[tuple[int, int], list[int]],
    refused: set[tuple[int, ...]],
    tuning: MatchTuning,
) -> list[_Trial]:
    """The nearest proposals, no two of which touch one track or one segment."""
    busy: set[tuple[int, int]] = set()
    trials = []
    # A proposal may name a track that has gone, or a view that its track now has.
    for proposal in sorted(p for each in proposals.values() for p in each):
        track, view, segment = proposal.track, proposal.view, proposal.segment
        if (FREE, track) in busy or (view, segment) in busy or now.index[track, view] >= 0:
            continue
        trial = _trial(seen, now, proposal, owners.get((view, segment), []), tuning)
        if trial is None or tuple(trial.index.tolist()) in refused:
            continue
        if trial.joined != FREE and (FREE, trial.joined) in busy:
            continue
        busy |= {(FREE, track), (view, segment), (FREE, trial.joined)} - {(FREE, FREE)}
        trials.append(trial)
    return trials


def _trial(
    seen: MatchInput,
    now: FittedTracks,
    proposal: _Proposal,
    owners: list[int],
    tuning: MatchTuning,
) -> _Trial | None:
    """What the track would be, None where its part of the segment is another's that is no part of
    the same line, or where too little is left that all views show."""
    track, view, segment = proposal.track, proposal.view, proposal.segment
    index = now.index[track].copy()
    index[view] = segment
    part = common_part(seen, index, now.common_mm[track])
    before = np.linalg.norm(now.common_mm[track][1] - now.common_mm[track][0])
    if part is None or np.linalg.norm(part[1] - part[0]) < tuning.tracks.min_shared * before:
        return None
    ends, matrix = seen.ends_px[view][segment], np.asarray(seen.lines.matrix_px)[view]
    place = segment_position(ends, matrix, part)
    claims = [
        other
        for other in owners
        if overlap_share(place, segment_position(ends, matrix, now.common_mm[other]))
        > tuning.selection.conflict_overlap
    ]
    if not claims:
        return _Trial(track, FREE, index, part)
    if len(claims) > 1:
        return None
    joined = claims[0]
    both = (index >= 0) & (now.index[joined] >= 0)
    if (index[both] != now.index[joined][both]).any():
        return None
    index = np.maximum(index, now.index[joined])
    part = common_part(seen, index, now.common_mm[track])
    if part is None or np.linalg.norm(part[1] - part[0]) < tuning.tracks.min_shared * before:
        return None
    return _Trial(track, joined, index, part)


def _as_tracks(seen: MatchInput, tracks: Tracks, now: FittedTracks) -> Tracks:
    interval = track_intervals(seen, now.index, now.common_mm)
    candidates = tracks.candidates._replace(
        index=now.index, interval=interval, ends_mm=now.common_mm
    )
    return tracks._replace(candidates=candidates)
