"""Segments of matched lines lengthened to where the edge ends, and gaps closed.

Beyond each end of a matched segment the picture is asked along its own line, whose place is known
better than any projection.
"""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry.projection import project_by_matrix
from trinoc.match.pixels.partners import joined_ends
from trinoc.match.pixels.state import State, ViewSegments, refit_tracks, with_view
from trinoc.match.pixels.views import EdgeResponse, PictureInput, ask
from trinoc.match.tuning.guided import GuidedTuning
from trinoc.numerics.tables import take_rows


def prolong_segments(
    state: State, pictures: list[PictureInput], tuning: GuidedTuning
) -> tuple[State, int]:
    """(the state with longer segments, how many ends have moved)."""
    changed = state
    for view, picture in enumerate(pictures):
        ends, answer = _beyond(state, view, picture, tuning)
        own = state.segments[view]
        table = [own.ends_px.copy(), own.covariance_px2.copy(), own.contrast, own.guided.copy()]
        for row, (segment, end) in enumerate(ends.tolist()):
            table[0][segment], table[1][segment] = lengthen(
                table[0][segment], table[1][segment], end, answer, row
            )
            table[3][segment] = True
        changed = with_view(changed, view, own._make(table))
    return _undo_disagreements(state, changed, tuning)


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
    return refit_tracks(changed, state.tracks), moved


def _beyond(
    state: State, view: int, picture: PictureInput, tuning: GuidedTuning
) -> tuple[np.ndarray, EdgeResponse]:
    """(segment and end of those whose edge goes on, the answers beyond them)."""
    own = state.segments[view]
    used = np.unique(state.tracks.index[:, view])
    used = used[used >= 0]
    ends = np.stack([np.repeat(used, 2), np.tile([0, 1], len(used))], axis=1)
    tests = max(len(ends), 1)
    ends = ends[~_at_corner(state, view, ends, tuning)]
    here = own.ends_px[ends[:, 0], ends[:, 1]]
    there = own.ends_px[ends[:, 0], 1 - ends[:, 1]]
    length = np.linalg.norm(here - there, axis=1)
    out = (here - there) / length[:, None]
    # Right at the end there may be a corner, with other edges about it.
    start = here + tuning.meet_px * out
    reach = tuning.prolong_px + tuning.prolong_share * length
    probe = np.stack([start, start + reach[:, None] * out], axis=1)
    gate = np.ones(len(ends))
    answer = ask(picture, probe, gate, gate / 2, np.full(len(ends), tuning.meet_px))
    answer = answer._replace(along_px=answer.along_px + tuning.meet_px)
    hit = answer.log_chance < np.log(tuning.false_alarms / tests)
    return take_rows((ends, answer), hit & (answer.length_px > tuning.shortest_px))


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


def lengthen(
    ends_px: Float[np.ndarray, "2 2"],
    covariance_px2: Float[np.ndarray, "4 4"],
    end: int,
    answer: EdgeResponse,
    row: int,
) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "4 4"]]:
    """A segment whose `end` moves out to that of the edge found beyond it, by least squares of
    both."""
    here, there = ends_px[end], ends_px[1 - end]
    before = float(np.linalg.norm(here - there))
    unit = (here - there) / before
    right = np.array([-unit[1], unit[0]])
    total = before + answer.along_px[row, 1]

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
