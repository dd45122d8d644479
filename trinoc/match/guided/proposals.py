"""Which pictures show a line that was asked for, and how likely it is one."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry import project_by_matrix
from trinoc.match.guided.joint import Asked, log_odds_of
from trinoc.match.guided.partners import Hypotheses
from trinoc.match.guided.state import State
from trinoc.match.guided.views import Answer
from trinoc.match.tracks import positions_abreast
from trinoc.match.tuning import GuidedTuning
from trinoc.numerics import take_rows


class Proposals(NamedTuple):
    """Lines that may be new tracks, the likeliest first.

    Fields
    ------
    asked_for : where they may be.
    members : (n, v) the views whose edges are of one line.
    log_odds : (n,) of that.
    answers : of every view.
    """

    asked_for: Hypotheses
    members: Bool[np.ndarray, "n v"]
    log_odds: Float[np.ndarray, "n"]
    answers: list[Answer]


def proposals_of(
    state: State,
    found: Asked,
    hypotheses: Hypotheses,
    size_px: Sequence[tuple[int, int]],
    looked_at: int,
    tuning: GuidedTuning,
) -> Proposals:
    """Of lines that were asked for, those that are likely; `looked_at` is how many there were
    before the pictures chose."""
    views = found.hit.shape[1]
    # How often a picture shows an edge where one was promising.
    chance = (found.hit.sum(axis=0) + 1) / (len(found.hit) + views)
    strict = np.log(tuning.false_alarms / looked_at)
    members = _overlapping(state, found, hypotheses.ends_mm, tuning)
    surely = _surely_two(found, members, strict)
    found, hypotheses, members = take_rows((found, hypotheses, members), surely)
    missed = np.log(tuning.missed) * _in_picture(state, hypotheses.ends_mm, size_px)
    choices = [members] + [members & (np.arange(views) != k) for k in range(views) if views > 2]
    log_odds = np.stack(
        [
            np.where(
                _surely_two(found, choice, strict),
                log_odds_of(found, hypotheses.covariance_mm2, choice, chance)
                + (missed * ~choice).sum(axis=1),
                -np.inf,
            )
            for choice in choices
        ]
    )
    log_odds += np.log(tuning.prior_new)
    best = log_odds.argmax(axis=0)
    every = np.arange(len(best))
    members, log_odds = np.stack(choices)[best, every], log_odds[best, every]
    rows = np.argsort(-log_odds, kind="stable")
    rows = rows[log_odds[rows] > tuning.new_log_odds]
    return take_rows(Proposals(hypotheses, members, log_odds, found.answers), rows)


def _surely_two(
    found: Asked, members: Bool[np.ndarray, "n v"], strict: float
) -> Bool[np.ndarray, "n"]:
    """Whether two views show an edge, and one of them would not by noise."""
    sure = np.stack([answer.log_chance < strict for answer in found.answers], axis=1)
    return (members.sum(axis=1) >= 2) & (members & sure).any(axis=1)


def _in_picture(
    state: State, lines_mm: Float[np.ndarray, "n 2 3"], size_px: Sequence[tuple[int, int]]
) -> Bool[np.ndarray, "n v"]:
    """Which pictures have the middle of each line within their borders."""
    middle = lines_mm.mean(axis=1)
    inside = []
    for matrix, size in zip(state.cameras.matrix_px, size_px, strict=True):
        place = project_by_matrix(matrix, middle)
        inside.append(((place >= 0) & (place <= np.array(size) - 1)).all(axis=1))
    return np.stack(inside, axis=1)


def _overlapping(
    state: State, found: Asked, lines: Float[np.ndarray, "n 2 3"], tuning: GuidedTuning
) -> Bool[np.ndarray, "n v"]:
    """The views of which each shares most of the shorter part with the longest."""
    reach = np.zeros((*found.hit.shape, 2))
    for view, (matrix, answer) in enumerate(
        zip(state.cameras.matrix_px, found.answers, strict=True)
    ):
        on = np.flatnonzero(found.hit[:, view])
        reach[on, view] = np.sort(positions_abreast(matrix, answer.ends_px[on], lines[on]), axis=1)
    length = np.where(found.hit, reach[..., 1] - reach[..., 0], 0.0)
    longest = reach[np.arange(len(lines)), length.argmax(axis=1)]
    low = np.maximum(reach[..., 0], longest[:, None, 0])
    high = np.minimum(reach[..., 1], longest[:, None, 1])
    return found.hit & (high - low > tuning.same_overlap * length)
