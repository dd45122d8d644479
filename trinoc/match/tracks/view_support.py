"""More than three views: how likely each track is, given which views show a segment on its line.

A track is found by three views. Every further view in whose picture its line lies either shows a
segment there or does not: evidence that the search did not use. Right lines are met in most views
that look at them. Wrong ones are met as often as lines that lie nowhere, such as copies of the
tracks that are moved in depth. Both rates are learned from the scene.

So a track that only three of six views show is doubtful, and one that all six show is not. A track
loses, too, where the segments of further views fit no better than chance would have it.

What neighbouring views show is not independent: what hides a line from one hides it from the next.
So the log likelihood ratios have weights below 1.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.projection import homogeneous_pixel
from trinoc.match.evidence.mixture import probability
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.observations.table import SegmentTable
from trinoc.match.selection.marginals import Tracks
from trinoc.match.tracks.consolidation import tail_of_tracks
from trinoc.match.tracks.line_fit import FittedTracks, fit_tracks
from trinoc.match.tracks.predicted_segments import predict_segments
from trinoc.match.tracks.unequal_errors import student_log_density
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.match.tuning.tracks import ViewSupportTuning
from trinoc.numerics.tables import take_rows


class HitRates(NamedTuple):
    """Shares of the lines in a view's picture on which it has a segment.

    right : (v, u) of right lines, in view v, where view u shows them. chance : (v,) of lines that
    lie nowhere.
    """

    right: Float[np.ndarray, "v v"]
    chance: Float[np.ndarray, "v"]


def with_view_support(inputs: MatchInput, tracks: Tracks, tuning: MatchTuning) -> Tracks:
    """Tracks whose posterior counts the views that show them, and those that do not."""
    index, rules = tracks.candidates.index, tuning.view_support
    if index.shape[1] <= 3 or len(index) < rules.fewest_tracks:
        return tracks
    fitted = fit_tracks(inputs, index, tracks.candidates.ends_mm)
    sound = np.isfinite(fitted.misfit) & np.isfinite(fitted.ends_mm).all(axis=(1, 2))
    if not sound.all():
        # What no view locates is left out later.
        part = with_view_support(inputs, tracks.take(sound), tuning)
        log_odds, members = tracks.posterior_log_odds.copy(), np.full(index.shape, np.nan)
        log_odds[sound] = part.posterior_log_odds
        if part.member_posterior is not None:
            members[sound] = part.member_posterior
        return tracks._replace(posterior_log_odds=log_odds, member_posterior=members)
    tail = tail_of_tracks(index, fitted.misfit, tuning)
    gate = tuning.candidates.gate
    in_picture = lines_in_pictures(inputs.lines, fitted.ends_mm) | (index >= 0)
    chance = chance_rates(inputs, fitted, gate, tuning)
    right = right_rates(index, in_picture, probability(tracks.posterior_log_odds), rules)
    rates = HitRates(right, chance)
    views = view_evidence(index, in_picture, rates, rules)
    fit = np.minimum(misfit_evidence(index, fitted.misfit, gate, tail), 0.0)
    support = rules.weight_of_views * views + rules.weight_of_misfit * fit
    return tracks._replace(
        posterior_log_odds=tracks.posterior_log_odds + support,
        member_posterior=member_posteriors(inputs, fitted, rates, gate, tail, rules),
    )


def lines_in_pictures(
    lines: SegmentTable, ends_mm: Float[np.ndarray, "t 2 3"]
) -> Bool[np.ndarray, "t v"]:
    """Whether the middle of each line, and one of its quarters, lie in each picture."""
    shares = np.array([0.25, 0.5, 0.75])[:, None]
    points = ends_mm[:, :1] + shares * (ends_mm[:, 1:] - ends_mm[:, :1])
    inside = np.zeros((len(ends_mm), len(lines.ends_px)), dtype=bool)
    for view, matrix in enumerate(np.asarray(lines.matrix_px)):
        image = homogeneous_pixel(matrix, points)
        depth = image[..., 2]
        pixel = image[..., :2] / np.where(depth > 0, depth, 1.0)[..., None]
        size = np.asarray(lines.size_px)[view]
        within = (depth > 0) & ((pixel > 0) & (pixel < size)).all(axis=-1)
        inside[:, view] = within[:, 1] & (within[:, 0] | within[:, 2])
    return inside


def chance_rates(
    inputs: MatchInput,
    tracks: FittedTracks,
    gate: float,
    tuning: MatchTuning,
) -> Float[np.ndarray, "v"]:
    """Share of wrong lines on which each view has a segment. Wrong lines are copies of the tracks,
    moved in depth along the rays of the mean centre of their cameras."""
    rules, random = tuning.view_support, np.random.default_rng(0)
    # A sample of some hundreds says the share well enough, in a time that does not grow.
    rows = np.resize(random.permutation(len(tracks.index)), rules.copies)
    tracks = take_rows(tracks, rows)
    centre = np.asarray(inputs.lines.centre_mm)
    members = tracks.index >= 0
    origin = (members @ centre / members.sum(axis=1, keepdims=True))[:, None]
    move = random.uniform(*rules.moved, len(rows)) * random.choice([-1, 1], len(rows))
    factor = (1 + move)[:, None, None]
    ends_mm = origin + factor * (tracks.ends_mm - origin)
    covariance_mm2 = tracks.covariance_mm2 * factor**2
    visible = lines_in_pictures(inputs.lines, ends_mm)
    hits = np.zeros(len(centre))
    for view, count in enumerate(inputs.counts):
        on = np.flatnonzero(visible[:, view])
        lines = ends_mm[on], covariance_mm2[on]
        met = predict_segments(inputs.lines, view, count, *lines, gate, tuning)
        # A copy near a camera's own ray stays on the segment of its track.
        other = met.segment != tracks.index[on[met.track], view]
        hits[view] = len(np.unique(met.track[other]))
    number = visible.sum(axis=0)
    return (hits + rules.prior_chance * rules.prior_lines) / (number + rules.prior_lines)


def right_rates(
    index: Int[np.ndarray, "t v"],
    in_picture: Bool[np.ndarray, "t v"],
    posterior: Float[np.ndarray, "t"],
    rules: ViewSupportTuning,
) -> Float[np.ndarray, "v v"]:
    """Share of right lines that have a segment in view v, of those that have one in view u and in
    three views other than v, which are tracks with or without v."""
    member = index >= 0
    has_three_others = (member.sum(axis=1, keepdims=True) - member) >= 3
    weight = posterior[:, None] * (in_picture & has_three_others)
    hits = (weight * member).T @ member
    number = weight.T @ member.astype(float)
    np.fill_diagonal(hits, 0.0)
    np.fill_diagonal(number, 0.0)
    mean = (hits.sum() + rules.prior_right) / (number.sum() + 1)
    return (hits + rules.prior_lines * mean) / (number + rules.prior_lines)


def view_evidence(
    index: Int[np.ndarray, "t v"],
    in_picture: Bool[np.ndarray, "t v"],
    rates: HitRates,
    rules: ViewSupportTuning,
) -> Float[np.ndarray, "t"]:
    """Log likelihood ratio of the views beyond the three that found each track."""
    member, right = index >= 0, expected_rates(index, rates, rules)
    met = np.where(member, np.log(right / rates.chance), 0.0).sum(axis=1)
    log_missed = np.log((1 - right) / (1 - rates.chance))
    missed = np.where(in_picture & ~member, log_missed, 0.0).sum(axis=1)
    count = member.sum(axis=1)
    return met * (count - 3) / count + missed


def expected_rates(
    index: Int[np.ndarray, "t v"], rates: HitRates, rules: ViewSupportTuning
) -> Float[np.ndarray, "t v"]:
    """Probability that each view has a segment on a right line, by the other views that show it:
    by the one that tells most."""
    right = np.where((index >= 0)[:, None, :], rates.right[None], 0.0)
    views = np.arange(index.shape[1])
    right[:, views, views] = 0.0
    return np.maximum(np.minimum(right.max(axis=2), rules.largest_rate), rates.chance)


def member_posteriors(
    inputs: MatchInput,
    tracks: FittedTracks,
    rates: HitRates,
    gate: float,
    noise_tail: float,
    rules: ViewSupportTuning,
) -> Float[np.ndarray, "t v"]:
    """Probability that each segment of tracks in four views or more is of the line of the others.

    Either a segment is of the line, or chance put it where the line's own segment is missing. By
    how much it raises the misfit is its chi-square about the line of the others. NaN where these
    give no line.
    """
    index = tracks.index
    posterior = np.full(index.shape, np.nan)
    row, view = np.nonzero((index >= 0) & ((index >= 0).sum(axis=1, keepdims=True) > 3))
    if len(row) == 0:
        return posterior
    others = index[row]
    others[np.arange(len(row)), view] = -1
    without = fit_tracks(inputs, others, tracks.common_mm[row]).misfit
    misfit_rise = np.maximum(tracks.misfit[row] - without, 0.0)
    right = expected_rates(index, rates, rules)[row, view]
    log_odds = np.log(right / (1 - right)) - np.log(rates.chance[view])
    log_odds += student_log_density(misfit_rise, noise_tail) + np.log(gate)
    posterior[row, view] = probability(log_odds)
    return posterior


def misfit_evidence(
    index: Int[np.ndarray, "t v"], misfit: Float[np.ndarray, "t"], gate: float, noise_tail: float
) -> Float[np.ndarray, "t"]:
    """Log likelihood ratio of how well the views beyond three fit: segments that lie there by
    chance do so anywhere up to the gate."""
    further = np.maximum((index >= 0).sum(axis=1) - 3, 0)
    each = misfit / (further + 1)
    return further * (student_log_density(each, noise_tail) + np.log(gate))
