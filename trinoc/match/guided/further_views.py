"""Lines that a view lacks: is the edge there after all, and what does it mean if it is not?

A line that two views show is asked for in the others. How often a place has an edge by chance is
measured beside it, on lines moved across; how often a right line is hidden, on the lines
themselves. An edge that is there makes a pair a triple. One that is not, where right lines are
seldom hidden, speaks against the pair.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry import project_by_matrix
from trinoc.match.guided.attach import known_in
from trinoc.match.guided.joint import asked
from trinoc.match.guided.state import State, Tracks, refitted, with_segments
from trinoc.match.guided.views import Answer, PictureInput, ask
from trinoc.match.tuning import GuidedTuning


class Shown(NamedTuple):
    """Fields
    ------
    lacking : (t, v) views that could show a line and have no segment of it.
    hit : (t, v) those that show an edge on it.
    chance : how often they do beside lines.
    """

    lacking: Bool[np.ndarray, "t v"]
    hit: Bool[np.ndarray, "t v"]
    chance: float


def with_further_views(
    state: State, pictures: list[PictureInput], tuning: GuidedTuning, *, weigh: bool
) -> tuple[State, int]:
    """(the state with more views on its tracks, how many); with `weigh` posteriors follow."""
    tracks = state.tracks
    if len(tracks.index) == 0:
        return state, 0
    found = asked(pictures, tracks.ends_mm, tracks.covariance_mm2, tracks.index < 0, tuning)
    lacking = (tracks.index < 0) & found.inside
    strict = np.log(tuning.false_alarms / max(int(lacking.sum()), 1))
    chances = np.stack([answer.log_chance for answer in found.answers], axis=1)
    spread = np.einsum("nvei,nij,nvfj->nvef", found.by_ends, tracks.covariance_mm2, found.by_ends)
    spread = spread + found.variance_px2 + tuning.straight_px**2 * np.eye(2)
    off = found.offset_px
    square = (off * np.linalg.solve(spread, off[..., None])[..., 0]).sum(axis=2)
    covered = np.stack([answer.covered for answer in found.answers], axis=1)
    hit = lacking & (chances < strict) & (square < tuning.gate) & (covered > tuning.least_covered)
    state, added = _attached(state, found.answers, hit, tuning)
    if weigh:
        shown = Shown(lacking, hit, _by_chance(state, pictures, lacking, strict, tuning))
        odds = state.tracks.log_odds + weight_of(shown, tracks.log_odds, tuning)
        state = state._replace(tracks=state.tracks._replace(log_odds=odds))
    return state, added


def weight_of(
    shown: Shown, log_odds: Float[np.ndarray, "t"], tuning: GuidedTuning
) -> Float[np.ndarray, "t"]:
    """What the views that lacked a line say about it, in log odds."""
    p = 1 / (1 + np.exp(-log_odds))
    weight = np.where(shown.lacking, p[:, None], 0.0)
    often = (weight[shown.hit].sum() + 1) / (weight.sum() + 2)
    often = min(max(often, shown.chance), 0.95)
    here = np.log(often) - np.log(shown.chance)
    gone = np.log1p(-often) - np.log1p(-shown.chance)
    each = np.where(shown.hit, here, np.where(shown.lacking, gone, 0.0))
    return tuning.temperature * each.sum(axis=1)


def lengths_mm(ends_mm: Float[np.ndarray, "t 2 3"]) -> Float[np.ndarray, "t"]:
    """From end to end."""
    return np.linalg.norm(ends_mm[:, 1] - ends_mm[:, 0], axis=1)


def _by_chance(
    state: State,
    pictures: list[PictureInput],
    lacking: Bool[np.ndarray, "t v"],
    strict: float,
    tuning: GuidedTuning,
) -> float:
    """How often a view shows an edge beside a line that it lacks, moved across to both sides."""
    number, met = 2.0, 1.0
    for view, picture in enumerate(pictures):
        rows = np.flatnonzero(lacking[:, view])
        image = project_by_matrix(picture.matrix_px, state.tracks.ends_mm[rows])
        way = image[:, 1] - image[:, 0]
        right = np.stack([-way[:, 1], way[:, 0]], axis=1)
        right /= np.linalg.norm(way, axis=1)[:, None]
        moves = np.repeat(tuning.control_px, len(rows))[:, None, None]
        probe = np.tile(image, (len(tuning.control_px), 1, 1))
        probe += moves * np.tile(right, (len(tuning.control_px), 1))[:, None]
        one = np.ones(len(probe))
        answer = ask(picture, probe, one, 0.5 * one, np.full(len(probe), np.inf))
        met += ((answer.log_chance < strict) & (answer.covered > tuning.least_covered)).sum()
        number += len(probe)
    return float(met / number)


def _attached(
    state: State,
    answers: list[Answer],
    hit: Bool[np.ndarray, "t v"],
    tuning: GuidedTuning,
) -> tuple[State, int]:
    """Tracks with the edges found, where these are no other track's and fit."""
    before = state.tracks
    index, grown = before.index.copy(), state
    for view, answer in enumerate(answers):
        rows = np.flatnonzero(hit[:, view])
        known = known_in(state, view, answer.ends_px[rows], tuning)
        for row, segment, track in zip(rows, known.segment, known.track, strict=True):
            if track >= 0:
                continue
            if segment < 0:
                one = slice(row, row + 1)
                contrast = answer.sign[one] * answer.contrast[one]
                grown = with_segments(
                    grown, view, answer.ends_px[one], answer.covariance_px2[one], contrast
                )
                segment = len(grown.segments[view].ends_px) - 1
            index[row, view] = segment
    changed = (index != before.index).any(axis=1)
    if not changed.any():
        return state, 0
    trial = refitted(grown, before._replace(index=index))
    fits = trial.tracks.misfit < np.maximum(before.misfit, 0) + tuning.gate
    long = lengths_mm(trial.tracks.ends_mm) > tuning.kept_share * lengths_mm(before.ends_mm)
    bad = changed & ~(fits & long)
    if not bad.any():
        return trial, int((index != before.index).sum())
    index[bad] = before.index[bad]
    if not (changed & ~bad).any():
        return state, 0
    kept = Tracks(index, *before[1:])
    return refitted(grown, kept), int((index != before.index).sum())
