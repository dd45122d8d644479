"""What all pictures answer about one line that may be there, taken together."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.geometry.projection import project_with_jacobian
from trinoc.match.pixels.partners import Hypotheses
from trinoc.match.pixels.probes import REACH
from trinoc.match.pixels.state import State
from trinoc.match.pixels.views import EdgeResponse, PictureInput, ask
from trinoc.match.tracks.line_fit import positions_abreast
from trinoc.match.tuning.guided import GuidedTuning
from trinoc.numerics.tables import take_rows


class EdgeQuery(NamedTuple):
    """Fields
    ------
    answers : of every picture.
    hit : (n, v) which show an edge.
    offset_px : (n, v, 2) where it lies beside the projected line, abreast of its two ends.
    variance_px2 : (n, v, 2, 2) of these.
    by_ends : (n, v, 2, 6) derivative of the projected ends across the line by the ends in space.
    area_px2 : (n, v) within which the two offsets may lie.
    """

    answers: list[EdgeResponse]
    hit: Bool[np.ndarray, "n v"]
    offset_px: Float[np.ndarray, "n v 2"]
    variance_px2: Float[np.ndarray, "n v 2 2"]
    by_ends: Float[np.ndarray, "n v 2 6"]
    area_px2: Float[np.ndarray, "n v"]


def query_pictures(
    pictures: list[PictureInput],
    ends_mm: Float[np.ndarray, "n 2 3"],
    covariance_mm2: Float[np.ndarray, "n 6 6"],
    tuning: GuidedTuning,
) -> EdgeQuery:
    """All pictures about the lines."""
    columns = [_of_view(picture, ends_mm, covariance_mm2, tuning) for picture in pictures]
    answers = [column[0] for column in columns]
    rest = [np.stack(list(part), axis=1) for part in zip(*(c[1:] for c in columns), strict=True)]
    return EdgeQuery(answers, *rest)


def _of_view(
    picture: PictureInput, ends_mm: np.ndarray, covariance_mm2: np.ndarray, tuning: GuidedTuning
) -> tuple[EdgeResponse, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    matrix = picture.matrix_px
    before = (ends_mm @ matrix[2, :3] + matrix[2, 3] > 0).all(axis=1)
    seen = project_with_jacobian(matrix, np.where(before[:, None, None], ends_mm, 0.0))
    image = seen.uv_px
    way = image[:, 1] - image[:, 0]
    length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    right = np.stack([-way[:, 1], way[:, 0]], axis=1) / length[:, None]
    across = np.einsum("ni,neij->nej", right, seen.by_point)
    by_ends = np.zeros((len(image), 2, 6))
    by_ends[:, 0, :3], by_ends[:, 1, 3:] = across[:, 0], across[:, 1]
    spread = np.einsum("nei,nij,nej->ne", by_ends, covariance_mm2, by_ends)
    most = np.sqrt(spread.max(axis=1))
    gate = np.clip(tuning.reach_sigmas * most, 1.0, REACH)
    answer = ask(picture, image, gate, most, np.full(len(image), np.inf))
    known = before & (length > tuning.shortest_px)
    hit = known & (answer.log_chance < np.log(tuning.weak))
    hit &= answer.length_px > tuning.shortest_px
    # The line of the edge abreast of the two ends.
    unit = way / length[:, None]
    off = answer.ends_px - image[:, :1]
    along = np.einsum("nei,ni->ne", off, unit)
    beside = np.einsum("nei,ni->ne", off, right)
    apart = along[:, 1] - along[:, 0]
    apart = np.where(np.abs(apart) > 1e-6, apart, 1.0)
    share = (np.stack([np.zeros(len(length)), length], axis=1) - along[:, :1]) / apart[:, None]
    weight = np.stack([1 - share, share], axis=2)
    blocks = answer.covariance_px2.reshape(-1, 2, 2, 2, 2)
    own = np.einsum("neifj,ni,nj->nef", blocks, right, right)
    width = 2 * gate + 1
    return (
        answer,
        hit,
        (weight @ beside[..., None])[..., 0],
        weight @ own @ weight.mT,
        by_ends,
        width * np.minimum(width, 5.0),
    )


def joint_log_odds(
    found: EdgeQuery,
    covariance_mm2: Float[np.ndarray, "n 6 6"],
    members: Bool[np.ndarray, "n v"],
    chance: Float[np.ndarray, "v"],
) -> Float[np.ndarray, "n"]:
    """Log likelihood ratio of one line in space that all members show, against edges that happen
    to lie beside it; `chance` is how often one does in each view, where noise may look like one."""
    count, views = members.shape
    design = found.by_ends.reshape(count, 2 * views, 6)
    spread = design @ covariance_mm2 @ design.mT
    for view in range(views):
        part = slice(2 * view, 2 * view + 2)
        spread[:, part, part] += found.variance_px2[:, view]
    on = np.repeat(members, 2, axis=1)
    both = on[:, :, None] & on[:, None, :]
    spread = np.where(both, spread, 2 * np.pi * np.eye(2 * views) / (2 * np.pi))
    offset = np.where(on, found.offset_px.reshape(count, 2 * views), 0.0)
    square = (offset * np.linalg.solve(spread, offset[..., None])[..., 0]).sum(axis=1)
    log_density = -0.5 * (
        square + np.linalg.slogdet(spread)[1] + on.sum(axis=1) * np.log(2 * np.pi)
    )
    noise = np.exp(np.stack([answer.log_chance for answer in found.answers], axis=1))
    happens = np.log(np.minimum(chance + noise, 1.0))
    area = np.log(np.where(members, found.area_px2, 1.0))
    clutter = np.where(members, area - happens, 0.0).sum(axis=1)
    return log_density + clutter


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
    answers: list[EdgeResponse]


def propose_lines(
    state: State,
    found: EdgeQuery,
    hypotheses: Hypotheses,
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
    choices = [members] + [members & (np.arange(views) != k) for k in range(views) if views > 2]
    log_odds = np.stack(
        [
            np.where(
                _surely_two(found, choice, strict),
                joint_log_odds(found, hypotheses.covariance_mm2, choice, chance),
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
    found: EdgeQuery, members: Bool[np.ndarray, "n v"], strict: float
) -> Bool[np.ndarray, "n"]:
    """Whether two views show an edge, and one of them would not by noise."""
    sure = np.stack([answer.log_chance < strict for answer in found.answers], axis=1)
    return (members.sum(axis=1) >= 2) & (members & sure).any(axis=1)


def _overlapping(
    state: State, found: EdgeQuery, lines: Float[np.ndarray, "n 2 3"], tuning: GuidedTuning
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
