"""Segments of matched lines lengthened to where the edge ends, and gaps closed.

Beyond each end of a matched segment the picture is asked along its own line, whose place is known
better than any projection. A segment is lengthened no further than a second view shows the line.
"""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry.projection import project_by_matrix
from trinoc.match.pixels.partners import joined_ends
from trinoc.match.pixels.state import State, ViewSegments, refit_tracks, with_view
from trinoc.match.pixels.views import EdgeResponse, PictureInput, ask
from trinoc.match.tracks.line_fit import positions_abreast
from trinoc.match.tuning.guided import GuidedTuning


def prolong_segments(
    state: State, pictures: list[PictureInput], tuning: GuidedTuning
) -> tuple[State, int]:
    """(the state with longer segments, how many ends have moved)."""
    found = [_beyond(state, view, picture, tuning) for view, picture in enumerate(pictures)]
    changed, moved = state, 0
    for view, (ends, answer, hit) in enumerate(found):
        allowed = _largest_extension(state, found, view)
        own = state.segments[view]
        table = [own.ends_px.copy(), own.covariance_px2.copy(), own.contrast, own.guided.copy()]
        for row in np.flatnonzero(hit).tolist():
            segment, end = ends[row].tolist()
            length = min(answer.along_px[row, 1], allowed[row])
            if length < tuning.least_gain_px:
                continue
            ends_px, covariance = lengthen(
                table[0][segment], table[1][segment], end, length, answer, row
            )
            table[0][segment], table[1][segment], table[3][segment] = ends_px, covariance, True
            moved += 1
        changed = with_view(changed, view, own._make(table))
    return _undo_disagreements(state, changed, tuning) if moved else (state, 0)


def _undo_disagreements(state: State, changed: State, tuning: GuidedTuning) -> tuple[State, int]:
    """Without what makes views disagree that agreed before."""
    trial = refit_tracks(changed, state.tracks)
    worse = trial.tracks.misfit > np.maximum(state.tracks.misfit, 0.0) + tuning.gate
    moved = 0
    for view, own in enumerate(state.segments):
        new = changed.segments[view]
        back = state.tracks.index[worse, view]
        keep = np.ones(len(own.ends_px), dtype=bool)
        keep[back[back >= 0]] = False
        table = [
            np.where(keep.reshape(-1, *[1] * (column.ndim - 1)), column, before)
            for column, before in zip(new, own, strict=True)
        ]
        changed = with_view(changed, view, ViewSegments(*table))
        moved += int((changed.segments[view].ends_px != own.ends_px).any(axis=(1, 2)).sum())
    if not moved:
        return state, 0
    return refit_tracks(changed, state.tracks) if worse.any() else trial, moved


def _beyond(
    state: State, view: int, picture: PictureInput, tuning: GuidedTuning
) -> tuple[np.ndarray, EdgeResponse, Bool[np.ndarray, "n"]]:
    """(segment and end, the answers beyond them, which are edges)."""
    own = state.segments[view]
    index = state.tracks.index[state.tracks.log_odds > tuning.trusted_log_odds, view]
    used = np.unique(index[index >= 0])
    ends = np.stack([np.repeat(used, 2), np.tile([0, 1], len(used))], axis=1)
    tests = max(len(ends), 1)
    ends = ends[~_at_corner(state, view, ends, tuning)]
    here = own.ends_px[ends[:, 0], ends[:, 1]]
    there = own.ends_px[ends[:, 0], 1 - ends[:, 1]]
    length = np.linalg.norm(here - there, axis=1)
    out = (here - there) / length[:, None]
    least = tuning.prolong_px + tuning.prolong_share * length
    reach = np.maximum(least, _extension_in_other_views(state, view, ends) + tuning.prolong_px / 2)
    # Right at the end there may be a corner, with other edges about it.
    start = here + tuning.corner_px * out
    reach = np.clip(reach, 0, tuning.longest_px)
    probe = np.stack([start, start + reach[:, None] * out], axis=1)
    gate = np.full(len(ends), tuning.prolong_gate_px)
    answer = ask(picture, probe, gate, 0.5 * gate, np.full(len(ends), tuning.gap_px))
    answer = answer._replace(along_px=answer.along_px + tuning.corner_px)
    hit = answer.log_chance < np.log(tuning.false_alarms / tests)
    hit &= answer.length_px > tuning.least_piece_px
    return ends, answer, hit & _continues(own, ends, answer, tuning)


def _at_corner(
    state: State, view: int, ends: np.ndarray, tuning: GuidedTuning
) -> Bool[np.ndarray, "n"]:
    """Whether the segment's end is that of a line that ends in a corner."""
    tracks = state.tracks
    met = joined_ends(state, tuning).met.reshape(-1, 2)
    on = np.flatnonzero(tracks.index[:, view] >= 0)
    image = project_by_matrix(state.cameras.matrix_px[view], tracks.ends_mm[on])
    corner = np.zeros((len(state.segments[view].ends_px), 2), dtype=bool)
    own = state.segments[view].ends_px[tracks.index[on, view]]
    apart = np.linalg.norm(own[:, :, None] - image[:, None], axis=3)
    close = (apart < tuning.meet_px + 2) & met[on][:, None, :]
    np.logical_or.at(corner, tracks.index[on, view], close.any(axis=2))
    return corner[ends[:, 0], ends[:, 1]]


def _continues(
    own: ViewSegments, ends: np.ndarray, answer: EdgeResponse, tuning: GuidedTuning
) -> Bool[np.ndarray, "n"]:
    """Whether the pieces found lie on the segments' own lines, as far as both are known.

    Another edge that leaves the same corner at a small angle does not.
    """
    segment, end = ends.T
    here, there = own.ends_px[segment, end], own.ends_px[segment, 1 - end]
    before = np.linalg.norm(here - there, axis=1)
    unit = (here - there) / before[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    piece = answer.ends_px - there[:, None]
    seen = np.einsum("nei,ni->ne", piece, right)
    share = np.einsum("nei,ni->ne", piece, unit) / before[:, None]
    weight = np.stack([1 - share, share], axis=2)
    blocks = own.covariance_px2[segment].reshape(-1, 2, 2, 2, 2)
    blocks = np.where((end == 0)[:, None, None, None, None], blocks[:, ::-1, :, ::-1], blocks)
    across = np.einsum("neifj,ni,nj->nef", blocks, right, right)
    spread = weight @ across @ weight.mT + tuning.straight_px**2 * np.eye(2)
    found = answer.covariance_px2.reshape(-1, 2, 2, 2, 2)
    spread += np.einsum("neifj,ni,nj->nef", found, right, right)
    square = (seen * np.linalg.solve(spread, seen[..., None])[..., 0]).sum(axis=1)
    return square < tuning.gate


def _extension_in_other_views(state: State, view: int, ends: np.ndarray) -> Float[np.ndarray, "n"]:
    """How far beyond each end any other view shows the line, px."""
    tracks = state.tracks
    span = np.stack(
        [np.nanmin(tracks.reach[..., 0], axis=1), np.nanmax(tracks.reach[..., 1], axis=1)], axis=1
    )
    return _farthest(state, view, ends, span)


def _farthest(
    state: State, view: int, ends: np.ndarray, span: Float[np.ndarray, "t 2"]
) -> Float[np.ndarray, "n"]:
    """How far beyond each end the image of any of its tracks' lines goes, px, at least 0; `span`
    are the ends of these, where 0 and 1 are the tracks' own."""
    tracks, own = state.tracks, state.segments[view].ends_px
    on = np.flatnonzero(tracks.index[:, view] >= 0)
    step = tracks.ends_mm[on, 1] - tracks.ends_mm[on, 0]
    line = tracks.ends_mm[on, :1] + span[on, :, None] * step[:, None]
    image = project_by_matrix(state.cameras.matrix_px[view], line)
    segment = own[tracks.index[on, view]]
    out = segment - segment[:, ::-1]
    out = out / np.linalg.norm(out, axis=2, keepdims=True)
    # Of both ends of a segment (axis 1) both ends of the line (axis 2).
    beyond = ((image[:, None] - segment[:, :, None]) * out[:, :, None]).sum(axis=3).max(axis=2)
    most = np.zeros((len(own), 2))
    np.maximum.at(most, tracks.index[on, view], np.nan_to_num(beyond, nan=0.0, posinf=0.0))
    return most[ends[:, 0], ends[:, 1]]


def _largest_extension(
    state: State, found: list[tuple[np.ndarray, EdgeResponse, np.ndarray]], view: int
) -> Float[np.ndarray, "n"]:
    """How far each end may move, px, so that a second view shows the line there too."""
    others = _reach_after(state, found)
    others[:, view] = np.nan
    span = np.stack(
        [np.fmin.reduce(others[..., 0], axis=1), np.fmax.reduce(others[..., 1], axis=1)], axis=1
    )
    return _farthest(state, view, found[view][0], span)


def _reach_after(
    state: State, found: list[tuple[np.ndarray, EdgeResponse, np.ndarray]]
) -> Float[np.ndarray, "t v 2"]:
    """Where every view's segment would begin and end along its track if all ends moved."""
    tracks = state.tracks
    reach = np.full(tracks.reach.shape, np.nan)
    for view, (ends, answer, hit) in enumerate(found):
        longer = state.segments[view].ends_px.copy()
        rows = np.flatnonzero(hit)
        segment, end = ends[rows].T
        here, there = longer[segment, end], longer[segment, 1 - end]
        out = (here - there) / np.linalg.norm(here - there, axis=1)[:, None]
        longer[segment, end] = here + answer.along_px[rows, 1:] * out
        on = np.flatnonzero(tracks.index[:, view] >= 0)
        matrix = state.cameras.matrix_px[view]
        places = positions_abreast(matrix, longer[tracks.index[on, view]], tracks.ends_mm[on])
        reach[on, view] = np.sort(places, axis=1)
    return reach


def lengthen(
    ends_px: Float[np.ndarray, "2 2"],
    covariance_px2: Float[np.ndarray, "4 4"],
    end: int,
    length: float,
    answer: EdgeResponse,
    row: int,
) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "4 4"]]:
    """A segment whose `end` moves out by `length`, by least squares of its line and of the
    edge found beyond it."""
    here, there = ends_px[end], ends_px[1 - end]
    before = float(np.linalg.norm(here - there))
    unit = (here - there) / before
    right = np.array([-unit[1], unit[0]])
    total = before + length

    def rows_beside_line(along: np.ndarray) -> np.ndarray:
        share = along / total
        return np.stack([1 - share, share], axis=1)

    # Offsets from the segment's own line, at its ends and at those of the piece found beyond.
    old = covariance_px2.reshape(2, 2, 2, 2)
    if end == 0:
        old = old[::-1, :, ::-1]
    own = np.einsum("eifj,i,j->ef", old, right, right)
    piece = answer.ends_px[row] - there
    new = answer.covariance_px2[row].reshape(2, 2, 2, 2)
    beyond = np.einsum("eifj,i,j->ef", new, right, right)
    design = np.concatenate(
        [rows_beside_line(np.array([0.0, before])), rows_beside_line(piece @ unit)]
    )
    information = np.zeros((4, 4))
    information[:2, :2], information[2:, 2:] = np.linalg.inv(own), np.linalg.inv(beyond)
    seen = np.concatenate([np.zeros(2), piece @ right])
    spread = np.linalg.inv(design.T @ information @ design)
    offset = spread @ design.T @ information @ seen
    places = np.stack([there + offset[0] * right, there + total * unit + offset[1] * right])
    along = np.array([unit @ old[0, :, 0] @ unit, unit @ new[1, :, 1] @ unit])
    covariance = np.einsum("ef,i,j->eifj", spread, right, right)
    covariance += np.einsum("ef,e,i,j->eifj", np.eye(2), along, unit, unit)
    if end == 0:
        places, covariance = places[::-1], covariance[::-1, :, ::-1]
    return places, covariance.reshape(4, 4)
