"""More than three views: test tracks as a whole, extend them into further views, and join them.

Each track predicts its line in every view that it lacks. A segment at the predicted position is
added, or its track is joined. The best fit comes first, and only if the line of all segments
together is consistent. So every member is tested again after each change.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates.table import no_candidates
from trinoc.match.observations.match_input import MatchInput, with_noise_scale
from trinoc.match.selection.marginals import Selection, Tracks, selected_tracks
from trinoc.match.tracks.assembly import typical_misfit
from trinoc.match.tracks.line_fit import (
    FittedTracks,
    are_consistent,
    common_part,
    fit_tracks,
    lie_before_cameras,
    line_end_positions,
    overlap_share,
    segment_position,
    split_off_misfits,
)
from trinoc.match.tracks.multiview import merge_triplets
from trinoc.match.tracks.predicted_segments import predict_segments
from trinoc.match.tracks.unequal_errors import degrees_of_misfit, fit_tail, misfit_limit
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.tables import concatenate_rows
from trinoc.numerics.tails import chi_square_tail

# numerical: label of a segment that is on no track.
NO_TRACK = -1


class _Proposal(NamedTuple):
    """Proposal to add a segment of another view to a track.

    Attributes
    ----------
    chi_square : float
        Chi-square of the segment under the prediction of the track.
    track, view, segment : int
        The track, and the segment to add.
    """

    chi_square: float
    track: int
    view: int
    segment: int


def tracks_through_views(
    inputs: MatchInput, selections: list[Selection], tuning: MatchTuning = DEFAULT
) -> tuple[Tracks, float]:
    """Build tracks from the selected triples of all triplets of views.

    Returns (tracks, noise factor), as `consolidate_tracks` does. With a single triplet, the triples
    are the tracks.
    """
    if not selections:
        no_tracks = no_candidates(len(inputs.ends_px), inputs.lines.frame is not None)
        return Tracks(no_tracks, np.zeros(0), np.zeros(0)), 1.0
    tracks = concatenate_rows([selected_tracks(selection) for selection in selections])
    if len(selections) == 1:
        return tracks, 1.0
    return consolidate_tracks(inputs, merge_triplets(inputs.lines, tracks, tuning), tuning)


def consolidate_tracks(
    inputs: MatchInput, tracks: Tracks, tuning: MatchTuning = DEFAULT
) -> tuple[Tracks, float]:
    """Remove inconsistent segments from tracks, and extend the tracks to further views.

    Returns (tracks, noise factor). The noise factor is the actual standard deviation of the errors
    over the stated one. It is estimated from the tracks, because many views show the errors of each
    camera. The first pass assumes equal errors of all tracks. The second pass allows for unequal
    errors (`tail_of_tracks`) and adds further segments.
    """
    fitted = fit_tracks(inputs, tracks.candidates.index, tracks.candidates.ends_mm)
    noise_factor = float(np.sqrt(typical_misfit(fitted.index, fitted.misfit, tuning.tracks)))
    inputs = with_noise_scale(inputs, np.array([noise_factor]))
    fitted = fit_tracks(inputs, fitted.index, fitted.common_mm)
    fitted = _grow(inputs, split_off_misfits(inputs, fitted, tuning), 0.0, tuning)
    is_kept = (fitted.index >= 0).any(axis=1)
    tail = tail_of_tracks(fitted.index[is_kept], fitted.misfit[is_kept], tuning)
    fitted = _grow(inputs, fitted, tail, tuning)
    is_kept = (fitted.index >= 0).any(axis=1)
    return _as_tracks(inputs, tracks, fitted).take(np.flatnonzero(is_kept)), noise_factor


def tail_of_tracks(
    index: Int[np.ndarray, "t v"], misfit: Float[np.ndarray, "t"], tuning: MatchTuning
) -> float:
    """Estimate how unequal the errors of the tracks are: `noise_tail`, see `fit_tail`.

    The estimate is limited to a maximum, because wrong tracks make it larger.
    """
    noise_tail = fit_tail(misfit, degrees_of_misfit(index), has_images=False)
    return min(noise_tail, tuning.tracks.max_tail)


def _grow(
    inputs: MatchInput, fitted: FittedTracks, noise_tail: float, tuning: MatchTuning
) -> FittedTracks:
    """Add to each track the segments near its predicted line, in views without a segment of the
    track.

    If a segment belongs to another track, the two tracks are joined. A track that was joined to
    another one has no segments in the result.
    """
    significance = chi_square_tail(tuning.candidates.gate, 2)
    gate = float(misfit_limit(significance, np.array(2), noise_tail))
    gate = min(gate, tuning.tracks.max_gate)
    is_alive = np.asarray((fitted.index >= 0).any(axis=1))
    rejected: set[tuple[int, ...]] = set()
    is_changed = is_alive.copy()
    proposals: dict[int, list[_Proposal]] = {}
    for _ in range(tuning.tracks.merge_rounds):
        proposals = {t: p for t, p in proposals.items() if is_alive[t] and not is_changed[t]}
        proposals |= _propose_segments(
            inputs, fitted, np.flatnonzero(is_alive & is_changed), gate, tuning
        )
        owners = _tracks_of_segments(inputs, fitted, is_alive)
        trials = _select_trials(inputs, fitted, is_alive, proposals, owners, rejected, tuning)
        if not trials:
            break
        index = np.array([trial.index for trial in trials])
        common = np.array([trial.common_mm for trial in trials])
        attempt = fit_tracks(inputs, index, common)
        is_consistent = are_consistent(inputs, attempt, tuning, noise_tail)
        is_consistent &= lie_before_cameras(inputs.lines, index, attempt.ends_mm)
        is_changed = np.zeros(len(is_alive), dtype=bool)
        columns = [column.copy() for column in fitted]
        for row, trial in enumerate(trials):
            if not is_consistent[row]:
                rejected.add(tuple(trial.index.tolist()))
                continue
            for column, new in zip(columns, attempt, strict=True):
                column[trial.track] = new[row]
            is_changed[trial.track] = True
            if trial.joined != NO_TRACK:
                is_alive[trial.joined] = False
        fitted = FittedTracks(*columns)
    return fitted._replace(index=np.where(is_alive[:, None], fitted.index, -1))


class _Trial(NamedTuple):
    """Extended track to be fitted and tested.

    Attributes
    ----------
    track : int
        Track that is extended.
    joined : int
        Track that is joined to the extended track, or NO_TRACK.
    index : (v,)
        Segments of the extended track.
    common_mm : (2, 3)
        Ends of the common part of its segments.
    """

    track: int
    joined: int
    index: Int[np.ndarray, "v"]
    common_mm: Float[np.ndarray, "2 3"]


def _propose_segments(
    inputs: MatchInput,
    fitted: FittedTracks,
    rows: Int[np.ndarray, "r"],
    gate: float,
    tuning: MatchTuning,
) -> dict[int, list[_Proposal]]:
    """For each track in `rows`, list the segments near its predicted line in the other views."""
    proposals: dict[int, list[_Proposal]] = {int(row): [] for row in rows}
    for view, count in enumerate(inputs.counts):
        lacking_view = rows[fitted.index[rows, view] < 0]
        ends_mm, covariance_mm2 = fitted.ends_mm[lacking_view], fitted.covariance_mm2[lacking_view]
        hits = predict_segments(inputs.lines, view, count, ends_mm, covariance_mm2, gate, tuning)
        for track, segment, chi_square in zip(*(column.tolist() for column in hits), strict=True):
            row = int(lacking_view[track])
            proposals[row].append(_Proposal(chi_square, row, view, segment))
    return proposals


def _tracks_of_segments(
    inputs: MatchInput, fitted: FittedTracks, is_alive: np.ndarray
) -> dict[tuple[int, int], list[int]]:
    """Return the tracks of each segment. The keys are (view, segment)."""
    owners: dict[tuple[int, int], list[int]] = {}
    for track in np.flatnonzero(is_alive).tolist():
        for view, segment in enumerate(fitted.index[track].tolist()):
            if segment >= 0:
                owners.setdefault((view, segment), []).append(track)
    return owners


def _select_trials(
    inputs: MatchInput,
    fitted: FittedTracks,
    is_alive: np.ndarray,
    proposals: dict[int, list[_Proposal]],
    owners: dict[tuple[int, int], list[int]],
    rejected: set[tuple[int, ...]],
    tuning: MatchTuning,
) -> list[_Trial]:
    """Build trials from the proposals with the smallest chi-square.

    No two trials have a common track or a common segment. `owners` are the tracks of each segment,
    by (view, segment). `rejected` are the segments of the extended tracks that failed before.
    """
    in_use: set[tuple[int, int]] = set()
    trials = []
    # A proposal may refer to a joined track, or to a view that its track has by now.
    for proposal in sorted(p for of_track in proposals.values() for p in of_track):
        track, view, segment = proposal.track, proposal.view, proposal.segment
        if (
            (NO_TRACK, track) in in_use
            or (view, segment) in in_use
            or fitted.index[track, view] >= 0
        ):
            continue
        trial = _build_trial(inputs, fitted, proposal, owners.get((view, segment), []), tuning)
        if trial is None or tuple(trial.index.tolist()) in rejected:
            continue
        if trial.joined != NO_TRACK and (NO_TRACK, trial.joined) in in_use:
            continue
        in_use |= {(NO_TRACK, track), (view, segment), (NO_TRACK, trial.joined)} - {
            (NO_TRACK, NO_TRACK)
        }
        trials.append(trial)
    return trials


def _build_trial(
    inputs: MatchInput,
    fitted: FittedTracks,
    proposal: _Proposal,
    owners: list[int],
    tuning: MatchTuning,
) -> _Trial | None:
    """Build the extended track of a proposal.

    The result is None if the segment conflicts with another line, or if the common part becomes too
    short.
    """
    track, view, segment = proposal.track, proposal.view, proposal.segment
    index = fitted.index[track].copy()
    index[view] = segment
    common_mm = common_part(inputs, index, fitted.common_mm[track])
    length_before = np.linalg.norm(fitted.common_mm[track][1] - fitted.common_mm[track][0])
    if (
        common_mm is None
        or np.linalg.norm(common_mm[1] - common_mm[0])
        < tuning.tracks.min_shared_part * length_before
    ):
        return None
    ends, matrix = inputs.ends_px[view][segment], np.asarray(inputs.lines.matrix_px)[view]
    position = segment_position(ends, matrix, common_mm)
    claimants = [
        other
        for other in owners
        if overlap_share(position, segment_position(ends, matrix, fitted.common_mm[other]))
        > tuning.selection.conflict_overlap
    ]
    if not claimants:
        return _Trial(track, NO_TRACK, index, common_mm)
    if len(claimants) > 1:
        return None
    joined = claimants[0]
    in_both = (index >= 0) & (fitted.index[joined] >= 0)
    if (index[in_both] != fitted.index[joined][in_both]).any():
        return None
    index = np.maximum(index, fitted.index[joined])
    common_mm = common_part(inputs, index, fitted.common_mm[track])
    if (
        common_mm is None
        or np.linalg.norm(common_mm[1] - common_mm[0])
        < tuning.tracks.min_shared_part * length_before
    ):
        return None
    return _Trial(track, joined, index, common_mm)


def _as_tracks(inputs: MatchInput, tracks: Tracks, fitted: FittedTracks) -> Tracks:
    interval = line_end_positions(inputs, fitted.index, fitted.common_mm)
    candidates = tracks.candidates._replace(
        index=fitted.index, interval=interval, ends_mm=fitted.common_mm
    )
    return tracks._replace(candidates=candidates)
