"""More than three views: update the probability of tracks by the views that show a segment on them.

Three views are enough for a track. Every further view that contains the line in its image either
shows a segment there or does not. This is evidence that the search did not use. Most views show a
segment on a right line. On a wrong line, they do so only as often as on random lines. Random lines
are copies of the tracks, displaced in depth. Both rates are estimated from the scene.

A track in only three of six views is therefore doubtful, and one in all six is not. A track also
loses if the segments of the further views fit no better than by chance. Neighbouring views are
not independent, because they have similar occlusions. The log likelihood ratios therefore have
weights below 1.
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
    """Share of lines for which a view has a segment, among the lines in its image.

    Attributes
    ----------
    true_lines : (v, u)
        Share of right lines with a segment in view v, among those with a segment in view u.
    random_lines : (v,)
        Share of random lines with a segment in view v.
    """

    true_lines: Float[np.ndarray, "v v"]
    random_lines: Float[np.ndarray, "v"]


def with_view_support(inputs: MatchInput, tracks: Tracks, tuning: MatchTuning) -> Tracks:
    """Update the posteriors of tracks by the views beyond three.

    Every further view is evidence: it has a segment on the line or none. With three views or fewer,
    the posteriors stay.
    """
    index, rules = tracks.candidates.index, tuning.view_support
    if index.shape[1] <= 3 or len(index) < rules.min_tracks:
        return tracks
    fitted = fit_tracks(inputs, index, tracks.candidates.ends_mm)
    is_sound = np.isfinite(fitted.misfit) & np.isfinite(fitted.ends_mm).all(axis=(1, 2))
    if not is_sound.all():
        # Tracks that no view locates are excluded later.
        sound_tracks = with_view_support(inputs, tracks.take(is_sound), tuning)
        log_odds, members = tracks.posterior_log_odds.copy(), np.full(index.shape, np.nan)
        log_odds[is_sound] = sound_tracks.posterior_log_odds
        if sound_tracks.member_posterior is not None:
            members[is_sound] = sound_tracks.member_posterior
        return tracks._replace(posterior_log_odds=log_odds, member_posterior=members)
    tail = tail_of_tracks(index, fitted.misfit, tuning)
    gate = tuning.candidates.gate
    in_image = lines_in_images(inputs.lines, fitted.ends_mm) | (index >= 0)
    random_rates = chance_rates(inputs, fitted, gate, tuning)
    true_rates = right_rates(index, in_image, probability(tracks.posterior_log_odds), rules)
    rates = HitRates(true_rates, random_rates)
    view_log_ratio = view_evidence(index, in_image, rates, rules)
    misfit_log_ratio = np.minimum(misfit_evidence(index, fitted.misfit, gate, tail), 0.0)
    support = rules.weight_of_views * view_log_ratio + rules.weight_of_misfit * misfit_log_ratio
    return tracks._replace(
        posterior_log_odds=tracks.posterior_log_odds + support,
        member_posterior=member_posteriors(inputs, fitted, rates, gate, tail, rules),
    )


def lines_in_images(
    lines: SegmentTable, ends_mm: Float[np.ndarray, "t 2 3"]
) -> Bool[np.ndarray, "t v"]:
    """Return the mask of the lines that lie mostly in the image of each view, (t, v).

    The midpoint and one of the quarter points must be inside the image.
    """
    shares = np.array([0.25, 0.5, 0.75])[:, None]
    points = ends_mm[:, :1] + shares * (ends_mm[:, 1:] - ends_mm[:, :1])
    inside = np.zeros((len(ends_mm), len(lines.ends_px)), dtype=bool)
    for view, matrix in enumerate(np.asarray(lines.matrix_px)):
        image = homogeneous_pixel(matrix, points)
        depth = image[..., 2]
        pixel = image[..., :2] / np.where(depth > 0, depth, 1.0)[..., None]
        size = np.asarray(lines.size_px)[view]
        is_inside = (depth > 0) & ((pixel > 0) & (pixel < size)).all(axis=-1)
        inside[:, view] = is_inside[:, 1] & (is_inside[:, 0] | is_inside[:, 2])
    return inside


def chance_rates(
    inputs: MatchInput,
    tracks: FittedTracks,
    gate: float,
    tuning: MatchTuning,
) -> Float[np.ndarray, "v"]:
    """Return the share of random lines for which each view has a segment, (v,).

    Random lines are copies of the tracks, displaced in depth along the rays from the mean centre of
    their cameras. `gate` is the chi-square limit for a segment on a line.
    """
    rules, random = tuning.view_support, np.random.default_rng(0)
    # A sample of some hundreds is precise enough, and its time does not grow with the scene.
    rows = np.resize(random.permutation(len(tracks.index)), rules.copies)
    tracks = take_rows(tracks, rows)
    centre = np.asarray(inputs.lines.centre_mm)
    members = tracks.index >= 0
    origin = (members @ centre / members.sum(axis=1, keepdims=True))[:, None]
    depth_change = random.uniform(*rules.displacement, len(rows)) * random.choice(
        [-1, 1], len(rows)
    )
    factor = (1 + depth_change)[:, None, None]
    ends_mm = origin + factor * (tracks.ends_mm - origin)
    covariance_mm2 = tracks.covariance_mm2 * factor**2
    visible = lines_in_images(inputs.lines, ends_mm)
    hits = np.zeros(len(centre))
    for view, count in enumerate(inputs.counts):
        visible_rows = np.flatnonzero(visible[:, view])
        lines = ends_mm[visible_rows], covariance_mm2[visible_rows]
        hit = predict_segments(inputs.lines, view, count, *lines, gate, tuning)
        # A copy that moves along a camera's ray stays on the segment of its track.
        is_other_segment = hit.segment != tracks.index[visible_rows[hit.track], view]
        hits[view] = len(np.unique(hit.track[is_other_segment]))
    visible_count = visible.sum(axis=0)
    return (hits + rules.prior_random_rate * rules.prior_lines) / (
        visible_count + rules.prior_lines
    )


def right_rates(
    index: Int[np.ndarray, "t v"],
    in_image: Bool[np.ndarray, "t v"],
    posterior: Float[np.ndarray, "t"],
    rules: ViewSupportTuning,
) -> Float[np.ndarray, "v v"]:
    """Return the probability that view v has a segment of a true line, by view u, (v, u).

    Row v, column u is estimated from the lines that lie in image v (`in_image`) and have a segment
    in view u: it is the part of them that has a segment in view v, too. Each line is weighted by
    its posterior. Only lines with segments in at least three views other than v are counted,
    because such lines are tracks even without a segment in view v.
    """
    is_member = index >= 0
    has_three_others = (is_member.sum(axis=1, keepdims=True) - is_member) >= 3
    weight = posterior[:, None] * (in_image & has_three_others)
    hits = (weight * is_member).T @ is_member
    trials = weight.T @ is_member.astype(float)
    np.fill_diagonal(hits, 0.0)
    np.fill_diagonal(trials, 0.0)
    mean = (hits.sum() + rules.prior_true_rate) / (trials.sum() + 1)
    return (hits + rules.prior_lines * mean) / (trials + rules.prior_lines)


def view_evidence(
    index: Int[np.ndarray, "t v"],
    in_image: Bool[np.ndarray, "t v"],
    rates: HitRates,
    rules: ViewSupportTuning,
) -> Float[np.ndarray, "t"]:
    """Return the log likelihood ratio of hits and misses in the views beyond three, (t,).

    A hit is a segment of the track in a view whose image contains the line.
    """
    is_member, expected = index >= 0, expected_rates(index, rates, rules)
    log_hit = np.where(is_member, np.log(expected / rates.random_lines), 0.0).sum(axis=1)
    log_missed = np.log((1 - expected) / (1 - rates.random_lines))
    log_miss_total = np.where(in_image & ~is_member, log_missed, 0.0).sum(axis=1)
    count = is_member.sum(axis=1)
    return log_hit * (count - 3) / count + log_miss_total


def expected_rates(
    index: Int[np.ndarray, "t v"], rates: HitRates, rules: ViewSupportTuning
) -> Float[np.ndarray, "t v"]:
    """Return the probability that each view has a segment on a right line, (t, v).

    The probability is the largest one of `rates.true_lines` over the other views of the track.
    """
    rate_by_view = np.where((index >= 0)[:, None, :], rates.true_lines[None], 0.0)
    views = np.arange(index.shape[1])
    rate_by_view[:, views, views] = 0.0
    return np.maximum(np.minimum(rate_by_view.max(axis=2), rules.max_rate), rates.random_lines)


def member_posteriors(
    inputs: MatchInput,
    tracks: FittedTracks,
    rates: HitRates,
    gate: float,
    noise_tail: float,
    rules: ViewSupportTuning,
) -> Float[np.ndarray, "t v"]:
    """Return the probability that each segment belongs to the line of the track's other segments,
    (t, v).

    The probability is computed for tracks in four or more views, and NaN elsewhere. The alternative
    is a segment that is there by chance, while the segment of the line is missing. The evidence is
    the increase of the misfit by the segment, which for a chance segment is uniform below `gate`.
    """
    index = tracks.index
    posterior = np.full(index.shape, np.nan)
    row, view = np.nonzero((index >= 0) & ((index >= 0).sum(axis=1, keepdims=True) > 3))
    if len(row) == 0:
        return posterior
    others = index[row]
    others[np.arange(len(row)), view] = -1
    misfit_without = fit_tracks(inputs, others, tracks.common_mm[row]).misfit
    misfit_rise = np.maximum(tracks.misfit[row] - misfit_without, 0.0)
    expected = expected_rates(index, rates, rules)[row, view]
    log_odds = np.log(expected / (1 - expected)) - np.log(rates.random_lines[view])
    log_odds += student_log_density(misfit_rise, noise_tail) + np.log(gate)
    posterior[row, view] = probability(log_odds)
    return posterior


def misfit_evidence(
    index: Int[np.ndarray, "t v"], misfit: Float[np.ndarray, "t"], gate: float, noise_tail: float
) -> Float[np.ndarray, "t"]:
    """Return the log likelihood ratio of the misfit of the views beyond three, (t,).

    For a wrong track, the chi-square of each further segment is assumed uniform between 0 and
    `gate`.
    """
    extra_views = np.maximum((index >= 0).sum(axis=1) - 3, 0)
    misfit_per_view = misfit / (extra_views + 1)
    return extra_views * (student_log_density(misfit_per_view, noise_tail) + np.log(gate))
