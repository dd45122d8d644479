"""More than three views: tracks are tested as wholes, grown into views they lack, and joined.

Each track predicts its line in every view that it lacks. What it meets there belongs to no track,
and is added, or to another, and the two are joined: the nearest first, and only if the line of all
segments together is consistent. So every member is tested again at every step.

Which segments of a view lie where tracks of other views predict them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.projection import project_with_jacobian
from trinoc.match.candidates.table import no_candidates
from trinoc.match.observations.match_input import MatchInput, with_noise_scale
from trinoc.match.observations.table import SegmentTable
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
    now = _grow(seen, split_off_misfits(seen, now, tuning.candidates.gate), 0.0, tuning)
    on = (now.index >= 0).any(axis=1)
    tail = fit_tail(now.misfit[on], degrees_of_misfit(now.index[on]), of_pictures=False)
    now = _grow(seen, now, tail, tuning)
    on = (now.index >= 0).any(axis=1)
    return _as_tracks(seen, tracks, now).take(np.flatnonzero(on)), larger


def _grow(
    seen: MatchInput, now: FittedTracks, noise_tail: float, tuning: MatchTuning
) -> FittedTracks:
    """Tracks with what they meet in the views that they lack; those that were joined to others
    hold no view."""
    gate = tuning.candidates.gate
    nearby = float(misfit_limit(chi_square_tail(gate, 2), np.array(2), noise_tail))
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
        good = consistent(attempt, gate, noise_tail)
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


# numerical: tracks compared at once with all segments of a view.
ROWS = 256


class PredictedSegments(NamedTuple):
    """Segments that pass the gate of a prediction: which track, segment, and chi-square."""

    track: Int[np.ndarray, "h"]
    segment: Int[np.ndarray, "h"]
    chi_square: Float[np.ndarray, "h"]


def predict_segments(
    lines: SegmentTable,
    view: int,
    count: int,
    ends_mm: Float[np.ndarray, "t 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
    gate: float,
    tuning: MatchTuning,
) -> PredictedSegments:
    """Segments of a view that overlap the image of a track's line and fit it, under the covariances
    of both: their chi-square, of 2 degrees of freedom, passes the gate."""
    ends = np.asarray(lines.ends_px)[view, :count]
    across = np.asarray(lines.across_px2)[view, :count]
    matrix = np.asarray(lines.matrix_px)[view]
    image = project_with_jacobian(matrix, ends_mm)
    found = [PredictedSegments(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    rows = np.flatnonzero((image.depth > 0).all(axis=1))
    for start in range(0, len(rows), ROWS):
        part = rows[start : start + ROWS]
        uv = image.uv_px[part]
        spread = _across_image(uv, image.by_point[part], covariance_mm2[part])
        # Only known places predict: elsewhere anything fits.
        known = np.maximum(spread[:, 0, 0], spread[:, 1, 1]) < tuning.candidates.vaguest_px**2
        track, segment, chi_square = _fitting(
            uv[known],
            spread[known],
            ends,
            across,
            gate,
            tuning.candidates.smallest_overlap,
        )
        found.append(PredictedSegments(part[known][track], segment, chi_square))
    return PredictedSegments(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _across_image(
    image_px: Float[np.ndarray, "t 2 2"],
    by_point: Float[np.ndarray, "t 2 2 3"],
    covariance_mm2: Float[np.ndarray, "t 6 6"],
) -> Float[np.ndarray, "t 2 2"]:
    """Covariance of the two ends of the image across it."""
    way = image_px[:, 1] - image_px[:, 0]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.linalg.norm(way, axis=1)[:, None]
    by_end = np.einsum("ti,teij->tej", normal, by_point)
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    return np.einsum("tei,teifj,tfj->tef", by_end, blocks, by_end)


def _fitting(
    image_px: Float[np.ndarray, "t 2 2"],
    spread_px2: Float[np.ndarray, "t 2 2"],
    ends_px: Float[np.ndarray, "n 2 2"],
    across_px2: Float[np.ndarray, "n 2 2"],
    gate: float,
    least_overlap: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    way = image_px[:, 1] - image_px[:, 0]
    squared = (way**2).sum(axis=1)
    offset = ends_px[None] - image_px[:, None, :1]
    place = (offset @ way[:, None, :, None])[..., 0] / squared[:, None, None]
    begin = np.clip(place.min(axis=2), 0.0, None)
    end = np.clip(place.max(axis=2), None, 1.0)
    reach = place[..., 1] - place[..., 0]
    overlaps = end - begin > least_overlap * np.minimum(1.0, np.abs(reach))
    off = (offset[..., 1] * way[:, None, None, 0] - offset[..., 0] * way[:, None, None, 1]) / (
        np.sqrt(squared)[:, None, None]
    )
    # Far away is far away, whatever the covariances: at most a few of the widest sigmas.
    widest = spread_px2.max(axis=(1, 2))[:, None] + across_px2.max(axis=(1, 2))
    near = np.abs(off).min(axis=2) ** 2 < gate * widest
    near |= off[..., 0] * off[..., 1] < 0
    i, j = np.nonzero(overlaps & near)
    # Distances where the common part begins and ends, with the covariances of both there.
    share = (np.stack([begin, end], axis=2)[i, j] - place[i, j, :1]) / reach[i, j, None]
    weight = np.stack([1 - share, share], axis=2)
    residual = (weight @ off[i, j][:, :, None])[..., 0]
    on_line = np.stack([begin, end], axis=2)[i, j]
    line_weight = np.stack([1 - on_line, on_line], axis=2)
    total = weight @ across_px2[j] @ weight.mT + line_weight @ spread_px2[i] @ line_weight.mT
    chi_square = (residual * np.linalg.solve(total, residual[..., None])[..., 0]).sum(axis=1)
    fits = chi_square < gate
    return i[fits], j[fits], chi_square[fits]
