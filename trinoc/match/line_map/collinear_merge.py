"""Tracks that are pieces of one straight line, joined: the best pair first, until none is left.

The log odds that two are one line are those of `collinearity`. Each joined line is fitted anew to
all of its segments, must fit them as a whole, and is compared with the others as it is then:
what is joined does not depend on the order of anything.
"""

import heapq
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import expit

from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.match.line_map.collinearity import (
    CollinearEvidence,
    LineDensity,
    collinear_log_odds,
    difference,
    gap_mm,
    line_density,
    nearby_lines,
    parallel_density,
)
from trinoc.match.line_map.line_fit import TrackTable, collect_fragments, fit_line, track_table
from trinoc.match.line_map.line_posterior import line_posteriors
from trinoc.match.line_map.lines import JoinedLines
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.line_map import CollinearTuning
from trinoc.numerics.precision import in_float64
from trinoc.numerics.tails import chi_square_tail


class _Group(NamedTuple):
    """Tracks taken for one line so far, their segments (view, segment), and that line.

    common_mm : ends of the parts that all views of each track show. posterior : the least.
    chi_square, degrees : 0 for a track alone. parallel : how dense parallel lines are.
    """

    tracks: tuple[int, ...]
    segments: frozenset[tuple[int, int]]
    common_mm: Float[np.ndarray, "k 2 3"]
    ends_mm: Float[np.ndarray, "2 3"]
    covariance_mm2: Float[np.ndarray, "6 6"]
    chi_square: float
    degrees: int
    parallel: float
    posterior: float


class _Problem(NamedTuple):
    pieces: TrackTable
    scene: LineDensity
    tuning: MatchTuning


@in_float64
def join_collinear(matches: Matches, rig: Rig, *, tuning: MatchTuning = DEFAULT) -> JoinedLines:
    """The straight lines that the tracks lie on, each estimated from all segments of its tracks.

    Two tracks are one line where that is at least 0.9 likely, and 0.7 that both are right: their
    difference under their covariances against how dense parallel and other lines are
    thereabouts, and how wide the gap is in pixels. The line then must fit all segments of all
    its tracks, at a level of 0.001. A segment that serves several tracks of a line
    counts once. Where the misfit of most tracks says that segments err by more than they state,
    all covariances are that much larger; and in few cases segments err by up to four times as much.

    Raises InputError where the covariance of the fragments is not known.
    """
    if matches.fragments_covariance_px2 is None:
        raise InputError(
            "These matches do not hold the covariance of their fragments, from which lines are "
            "estimated: match the segments again with this version."
        )
    # In an order of their own, so that that of the matches is nothing to the answer.
    order = np.lexsort(np.asarray(matches.lines_mm).reshape(-1, 6).T)
    pieces = track_table(matches, rig, order, tuning.tracks)
    if len(order) == 0:
        return _as_lines([], pieces, order, 0.0, tuning.collinear)
    rules = tuning.collinear
    near = nearby_lines(pieces.ends_mm, pieces.covariance_mm2, rules)
    one, other = near.pairs.T
    apart = difference(
        *(a[k] for k in (one, other) for a in (pieces.ends_mm, pieces.covariance_mm2)),
        tuning=tuning.evidence,
    )
    scene = line_density(pieces.ends_mm, tuning.evidence)
    parallel = parallel_density(near, apart, scene, rules)
    surely_others = apart.square > rules.gate_sigmas**2
    alone = [
        _Group(
            (t,),
            frozenset((v, s) for v, s in enumerate(pieces.index[t].tolist()) if s >= 0),
            pieces.common_mm[t : t + 1],
            pieces.ends_mm[t],
            pieces.covariance_mm2[t],
            0.0,
            0,
            float(parallel[t]),
            float(pieces.posterior[t]),
        )
        for t in range(len(order))
    ]
    problem = _Problem(pieces, scene, tuning)
    groups = _agglomerate(alone, near.pairs[~surely_others], problem)
    return _as_lines(groups, pieces, order, matches.noise_tail, rules)


def _agglomerate(
    groups: list[_Group], pairs: Int[np.ndarray, "p 2"], problem: _Problem
) -> list[_Group]:
    """Groups of which no two more are one line."""
    rules = problem.tuning.collinear
    alive = dict(enumerate(groups))
    beside: dict[int, set[int]] = {number: set() for number in alive}
    for one, other in pairs.tolist():
        beside[one].add(other)
        beside[other].add(one)
    queue: list[tuple[float, int, int]] = []

    def compare(found: np.ndarray) -> None:
        ones, others = ([alive[i] for i in side] for side in found.T.tolist())
        odds = _odds(ones, others, problem)
        right = np.array([a.posterior * b.posterior for a, b in zip(ones, others, strict=True)])
        sure = (expit(odds) >= rules.min_posterior) & (right >= rules.trusted_posterior)
        for value, (one, other) in zip(odds[sure].tolist(), found[sure].tolist(), strict=True):
            heapq.heappush(queue, (-value, one, other))

    compare(pairs)
    number = len(groups)
    while queue:
        _, one, other = heapq.heappop(queue)
        if one not in alive or other not in alive:
            continue
        joined = _join_groups(alive[one], alive[other], problem)
        if joined is None:
            continue
        near = sorted((beside.pop(one) | beside.pop(other)) - {one, other})
        del alive[one], alive[other]
        alive[number], beside[number] = joined, set(near)
        for neighbour in near:
            beside[neighbour] -= {one, other}
            beside[neighbour].add(number)
        if near:
            compare(np.array([[neighbour, number] for neighbour in near]))
        number += 1
    return list(alive.values())


def _least_gaps(ones: list[_Group], others: list[_Group]) -> Float[np.ndarray, "p"]:
    """The smallest gap between a piece of one and a piece of the other."""
    rows, first, second = [], [], []
    for row, (one, other) in enumerate(zip(ones, others, strict=True)):
        for piece in one.common_mm:
            rows.extend([row] * len(other.common_mm))
            first.extend([piece] * len(other.common_mm))
            second.extend(other.common_mm)
    least = np.full(len(ones), np.inf)
    np.minimum.at(least, rows, gap_mm(np.array(first), np.array(second)))
    return least


def _odds(ones: list[_Group], others: list[_Group], problem: _Problem) -> Float[np.ndarray, "p"]:
    if not ones:
        return np.zeros(0)
    apart = difference(
        *(
            np.stack([getattr(group, field) for group in groups])
            for groups in (ones, others)
            for field in ("ends_mm", "covariance_mm2")
        ),
        tuning=problem.tuning.evidence,
    )
    scale = problem.pieces.px_per_mm
    both = list(zip(ones, others, strict=True))
    evidence = CollinearEvidence(
        apart,
        np.array([max(a.parallel, b.parallel) for a, b in both]),
        np.array([not a.segments.isdisjoint(b.segments) for a, b in both]),
        _least_gaps(ones, others),
        np.array([scale[[*a.tracks, *b.tracks]].mean() for a, b in both]),
    )
    return collinear_log_odds(evidence, problem.scene, problem.tuning)


def _join_groups(one: _Group, other: _Group, problem: _Problem) -> _Group | None:
    """The line of both groups' segments; None where it does not fit them."""
    tracks = tuple(sorted(one.tracks + other.tracks))
    longer = max(one, other, key=_length_mm)
    way = longer.ends_mm[1] - longer.ends_mm[0]
    way /= np.linalg.norm(way)
    ends = np.concatenate([one.ends_mm, other.ends_mm])
    blocks = np.stack(
        [g.covariance_mm2[k : k + 3, k : k + 3] for g in (one, other) for k in (0, 3)]
    )
    place = (ends - longer.ends_mm[0]) @ way
    outer = [int(np.argmin(place)), int(np.argmax(place))]
    rules = problem.tuning.collinear
    reach = longer.ends_mm[0] + place[outer, None] * way
    fit = fit_line(collect_fragments(problem.pieces, tracks), reach, rules)
    fits = chi_square_tail(fit.chi_square, fit.degrees) >= rules.significance
    if not (fits and np.isfinite(fit.covariance_mm2).all()):
        return None
    way = fit.ends_mm[1] - fit.ends_mm[0]
    way /= np.linalg.norm(way)
    covariance = fit.covariance_mm2.copy()
    for end in (0, 1):
        along = way @ blocks[outer[end]] @ way
        covariance[3 * end : 3 * end + 3, 3 * end : 3 * end + 3] += along * np.outer(way, way)
    parallel = max(one.parallel, other.parallel)
    return _Group(
        tracks,
        one.segments | other.segments,
        np.concatenate([one.common_mm, other.common_mm]),
        fit.ends_mm,
        covariance,
        fit.chi_square,
        fit.degrees,
        parallel,
        min(one.posterior, other.posterior),
    )


def _length_mm(group: _Group) -> float:
    return float(np.linalg.norm(group.ends_mm[1] - group.ends_mm[0]))


def _as_lines(
    groups: list[_Group],
    pieces: TrackTable,
    order: Int[np.ndarray, "t"],
    tail: float,
    rules: CollinearTuning,
) -> JoinedLines:
    """Lines in the order of the first of the caller's tracks on each."""
    groups = sorted(groups, key=lambda group: int(order[list(group.tracks)].min()))
    given = np.array([group.ends_mm for group in groups]).reshape(-1, 2, 3)
    blocks = np.array([group.covariance_mm2 for group in groups]).reshape(-1, 6, 6)
    shown = [collect_fragments(pieces, group.tracks) for group in groups]
    posterior = np.array([group.posterior for group in groups])
    likely = line_posteriors(shown, given, posterior, tail, rules)
    line_of_track = np.zeros(len(order), dtype=np.int64)
    place = np.zeros((len(order), 2))
    for number, group in enumerate(groups):
        tracks, ends = list(group.tracks), likely.ends_mm[number]
        way = ends[1] - ends[0]
        along = (pieces.ends_mm[tracks] - ends[0]) @ (way / np.linalg.norm(way))
        line_of_track[order[tracks]], place[order[tracks]] = number, np.sort(along, axis=1)
    scale = [pieces.px_per_mm[list(group.tracks)].mean() for group in groups]
    return JoinedLines(
        likely.ends_mm,
        likely.covariance_mm2 + _project_along(likely.ends_mm, blocks),
        np.array([group.chi_square for group in groups]),
        np.array([group.degrees for group in groups], dtype=np.int64),
        line_of_track,
        place,
        np.array(scale),
        posterior,
    )


def _project_along(
    ends_mm: Float[np.ndarray, "e 2 3"], covariance_mm2: Float[np.ndarray, "e 6 6"]
) -> Float[np.ndarray, "e 6 6"]:
    """What of a covariance lies along the lines, at each end alone."""
    way = ends_mm[:, 1] - ends_mm[:, 0]
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    variance = np.einsum("ni,neiej,nj->ne", way, blocks, way)
    spread = np.einsum("ne,ef,ni,nj->neifj", variance, np.eye(2), way, way)
    return spread.reshape(-1, 6, 6)
