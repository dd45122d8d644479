"""New lines: those of the hypotheses that two pictures or more show."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.geometry import project_by_matrix
from trinoc.match.guided.attach import NONE, known_in
from trinoc.match.guided.corners import corners_of, ends_of, mm_per_px
from trinoc.match.guided.joint import Asked, asked, log_odds_of
from trinoc.match.guided.partners import hypotheses_of
from trinoc.match.guided.state import State, Tracks, refitted, tables_of, with_segments
from trinoc.match.guided.views import PictureInput, plausible
from trinoc.match.tracks import direction_doubt, positions_abreast
from trinoc.match.tuning import GuidedTuning


def with_new_lines(
    state: State,
    pictures: list[PictureInput],
    before_mm: Float[np.ndarray, "m 2 3"],
    tuning: GuidedTuning,
) -> tuple[State, int, Float[np.ndarray, "k 2 3"]]:
    """(the state with new tracks, how many, the lines asked for); `before_mm` are those of earlier
    rounds, which are not asked for again."""
    ends = ends_of(state, tuning)
    if len(ends.place_mm) == 0:
        return state, 0, before_mm
    corners = corners_of(state, ends, tuning)
    hypotheses = hypotheses_of(state, ends, corners, tuning)
    new = _first_time(hypotheses.ends_mm, before_mm, tuning)
    before_mm = np.concatenate([before_mm, hypotheses.ends_mm[new]])
    rows = np.flatnonzero(new)
    if len(rows) == 0:
        return state, 0, before_mm
    quick = np.stack(
        [
            plausible(
                picture,
                project_by_matrix(picture.matrix_px, hypotheses.ends_mm[rows]),
                tuning.plausible_share,
                tuning.plausible_sigmas,
            )
            for picture in pictures
        ],
        axis=1,
    )
    enough = quick.sum(axis=1) >= 2
    rows, quick = rows[enough], quick[enough]
    if len(rows) == 0:
        return state, 0, before_mm
    lines, covariance = hypotheses.ends_mm[rows], hypotheses.covariance_mm2[rows]
    found = asked(pictures, lines, covariance, quick, tuning)
    members = _overlapping(state, found, lines, tuning)
    views = len(pictures)
    chance = (found.hit.sum(axis=0) + 1) / (found.inside.sum(axis=0) + views)
    strict = np.log(tuning.false_alarms / len(lines))
    sure = np.stack([answer.log_chance < strict for answer in found.answers], axis=1)
    in_picture = _in_picture(pictures, lines)
    log_odds = np.full(len(lines), -np.inf)
    best = members.copy()
    for left in [()] + [(view,) for view in range(views) if views > 2]:
        trial = members.copy()
        trial[:, list(left)] = False
        odds = log_odds_of(found, covariance, trial, chance) + np.log(tuning.prior_new)
        odds += (in_picture & ~trial).sum(axis=1) * np.log(tuning.missed)
        odds = np.where((trial.sum(axis=1) >= 2) & (trial & sure).any(axis=1), odds, -np.inf)
        better = odds > log_odds
        log_odds[better], best[better] = odds[better], trial[better]
    members = best
    rows = np.flatnonzero(log_odds > tuning.new_log_odds)
    rows = rows[np.argsort(-log_odds[rows], kind="stable")]
    return *_accepted(state, found, members, lines, log_odds, rows, tuning), before_mm


def _in_picture(
    pictures: list[PictureInput], lines_mm: Float[np.ndarray, "n 2 3"]
) -> Bool[np.ndarray, "n v"]:
    """Which pictures have the middle of each line within their borders."""
    middle = lines_mm.mean(axis=1)
    inside = []
    for picture in pictures:
        place = project_by_matrix(picture.matrix_px, middle)
        inside.append(((place >= 0) & (place <= np.array(picture.size_px) - 1)).all(axis=1))
    return np.stack(inside, axis=1)


def _first_time(
    lines_mm: Float[np.ndarray, "n 2 3"],
    before_mm: Float[np.ndarray, "m 2 3"],
    tuning: GuidedTuning,
) -> Bool[np.ndarray, "n"]:
    """Whether no such line has been asked for, either way round."""
    if len(before_mm) == 0 or len(lines_mm) == 0:
        return np.ones(len(lines_mm), dtype=bool)
    both = np.concatenate([before_mm, before_mm[:, ::-1]]).reshape(-1, 6)
    apart = KDTree(both).query(lines_mm.reshape(-1, 6))[0]
    return np.asarray(apart) > tuning.asked_again_mm


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


def _accepted(
    state: State,
    found: Asked,
    members: Bool[np.ndarray, "n v"],
    lines: Float[np.ndarray, "n 2 3"],
    log_odds: Float[np.ndarray, "n"],
    rows: Int[np.ndarray, "r"],
    tuning: GuidedTuning,
) -> tuple[State, int]:
    """One after the other, the likeliest first, those that claim nothing that is taken."""
    now, count = state, 0
    for row in rows.tolist():
        index = np.full(members.shape[1], NONE)
        claims: list[int] = []
        grown = now
        for view in np.flatnonzero(members[row]).tolist():
            answer = found.answers[view]
            known = known_in(grown, view, answer.ends_px[row : row + 1], tuning)
            if known.track[0] >= 0:
                claims.append(int(known.track[0]))
            index[view] = known.segment[0]
            if index[view] < 0:
                contrast = answer.sign[row : row + 1] * answer.contrast[row : row + 1]
                grown = with_segments(
                    grown,
                    view,
                    answer.ends_px[row : row + 1],
                    answer.covariance_px2[row : row + 1],
                    contrast,
                )
                index[view] = len(grown.segments[view].ends_px) - 1
        if claims:
            continue
        trial = refitted(
            grown._replace(tracks=_one(index, float(log_odds[row]), lines[row])),
            _one(index, float(log_odds[row]), lines[row]),
        ).tracks
        if trial.misfit[0] > tuning.gate or not _as_asked(grown, trial, lines[row], tuning):
            continue
        merged = Tracks(*(np.concatenate([a, b]) for a, b in zip(now.tracks, trial, strict=True)))
        now, count = grown._replace(tracks=merged), count + 1
    return now, count


def _as_asked(
    state: State, trial: Tracks, line_mm: Float[np.ndarray, "2 3"], tuning: GuidedTuning
) -> bool:
    """Whether its views locate a new line, and where it was asked for."""
    doubt = direction_doubt(tables_of(state).lines, trial.index)
    if not np.isfinite(trial.ends_mm).all() or doubt[0] >= tuning.largest_doubt:
        return False
    way = line_mm[1] - line_mm[0]
    unit = way / np.linalg.norm(way)
    off = trial.ends_mm[0] - line_mm[0]
    across = np.linalg.norm(off - (off @ unit)[:, None] * unit, axis=1)
    return bool((across < tuning.as_asked_px * mm_per_px(state, trial.ends_mm[0])).all())


def _one(index: np.ndarray, log_odds: float, line_mm: np.ndarray) -> Tracks:
    return Tracks(
        index[None],
        np.array([log_odds]),
        line_mm[None],
        np.zeros((1, 6, 6)),
        np.zeros(1),
        np.zeros((1, len(index), 2)),
    )
