"""Join tracks that are pieces of one straight line, the best pair first.

`collinearity` gives the log odds that two tracks are one line. Each joined line is fitted again
to all of its segments, must fit them as a whole, and is compared with its neighbours again. The
result does not depend on the order of the tracks.
"""

import heapq
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

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
    """Tracks that have been joined to one straight line so far.

    Attributes
    ----------
    tracks : tuple of int
        Indices of the tracks.
    segments : frozenset of (view, segment)
        Segments of the tracks.
    common_mm : (k, 2, 3)
        Ends of the part that all segments of a track show, for each track.
    ends_mm, covariance_mm2 : (2, 3) and (6, 6)
        Ends of the line, world frame, and their covariance.
    chi_square, degrees : float and int
        Misfit of the segments to the line and its degrees of freedom; 0 for a single track.
    parallel_density : float
        Number of lines parallel to this line, per mm^2 across it.
    posterior : float
        Smallest posterior of the tracks.
    """

    tracks: tuple[int, ...]
    segments: frozenset[tuple[int, int]]
    common_mm: Float[np.ndarray, "k 2 3"]
    ends_mm: Float[np.ndarray, "2 3"]
    covariance_mm2: Float[np.ndarray, "6 6"]
    chi_square: float
    degrees: int
    parallel_density: float
    posterior: float


class _Problem(NamedTuple):
    pieces: TrackTable
    scene: LineDensity
    tuning: MatchTuning


@in_float64
def join_collinear(matches: Matches, rig: Rig, *, tuning: MatchTuning = DEFAULT) -> JoinedLines:
    """Join collinear tracks to straight lines, each estimated from all segments of its tracks.

    Parameters
    ----------
    matches : Matches
        The tracks, with the covariance of their fragments (the parts of segments on the tracks).
    rig : Rig
        The cameras.
    tuning : MatchTuning
        Tuned constants; the group `collinear` is used here.

    Returns
    -------
    JoinedLines
        The lines, and the line of each track.

    Raises
    ------
    InputError
        If the matches have no covariance of their fragments.

    Notes
    -----
    Two tracks are joined under two conditions. The probability that both tracks are one line is at
    least 0.9. The probability that both tracks are right is at least 0.7. The first probability
    compares two hypotheses: one line, or two lines that are near each other by chance. It uses the
    difference of the tracks in space, the density of other lines, and the gap in pixels.

    The joined line must fit all segments at a significance of 0.001. A segment of several tracks is
    used once. If most tracks have residuals larger than the stated errors, all covariances are
    scaled. A few segments may have errors up to five times as large.
    """
    if matches.fragments_covariance_px2 is None:
        raise InputError(
            "These matches do not contain the covariance of their fragments, from which lines are "
            "estimated: match the segments again with this version."
        )
    # Sorted by position, so that the result does not depend on the order of the matches.
    order = np.lexsort(np.asarray(matches.lines_mm).reshape(-1, 6).T)
    pieces = track_table(matches, rig, order, tuning.tracks)
    if len(order) == 0:
        return _build_lines([], pieces, order, 0.0, tuning.collinear)
    line_tuning = tuning.collinear
    nearby = nearby_lines(pieces.ends_mm, pieces.covariance_mm2, line_tuning)
    first, second = nearby.pairs.T
    differences = difference(
        *(a[k] for k in (first, second) for a in (pieces.ends_mm, pieces.covariance_mm2)),
        tuning=tuning.evidence,
    )
    scene = line_density(pieces.ends_mm, tuning.evidence)
    density = parallel_density(nearby, differences, scene, line_tuning)
    is_other_line = differences.square > line_tuning.gate_sigmas**2
    single_tracks = [
        _Group(
            (t,),
            frozenset((v, s) for v, s in enumerate(pieces.index[t].tolist()) if s >= 0),
            pieces.common_mm[t : t + 1],
            pieces.ends_mm[t],
            pieces.covariance_mm2[t],
            0.0,
            0,
            float(density[t]),
            float(pieces.posterior[t]),
        )
        for t in range(len(order))
    ]
    problem = _Problem(pieces, scene, tuning)
    groups = _agglomerate(single_tracks, nearby.pairs[~is_other_line], problem)
    return _build_lines(groups, pieces, order, matches.noise_tail, line_tuning)


def _agglomerate(
    groups: list[_Group], pairs: Int[np.ndarray, "p 2"], problem: _Problem
) -> list[_Group]:
    """Join the two most probable groups repeatedly, until no pair of groups is probable enough.

    `pairs` (p, 2) are the pairs of groups that are nearly collinear.
    """
    rules = problem.tuning.collinear
    active = dict(enumerate(groups))
    neighbours: dict[int, set[int]] = {group_id: set() for group_id in active}
    for first, second in pairs.tolist():
        neighbours[first].add(second)
        neighbours[second].add(first)
    queue: list[tuple[float, int, int]] = []

    def compare(group_pairs: np.ndarray) -> None:
        first_groups, second_groups = ([active[i] for i in side] for side in group_pairs.T.tolist())
        odds = _pair_log_odds(first_groups, second_groups, problem)
        both_right = np.array(
            [a.posterior * b.posterior for a, b in zip(first_groups, second_groups, strict=True)]
        )
        is_likely = scipy.special.expit(odds) >= rules.min_posterior
        is_likely &= both_right >= rules.trusted_posterior
        for value, (first, second) in zip(
            odds[is_likely].tolist(), group_pairs[is_likely].tolist(), strict=True
        ):
            heapq.heappush(queue, (-value, first, second))

    compare(pairs)
    group_id = len(groups)
    while queue:
        _, first, second = heapq.heappop(queue)
        if first not in active or second not in active:
            continue
        merged = _join_groups(active[first], active[second], problem)
        if merged is None:
            continue
        near_groups = sorted((neighbours.pop(first) | neighbours.pop(second)) - {first, second})
        del active[first], active[second]
        active[group_id], neighbours[group_id] = merged, set(near_groups)
        for neighbour in near_groups:
            neighbours[neighbour] -= {first, second}
            neighbours[neighbour].add(group_id)
        if near_groups:
            compare(np.array([[neighbour, group_id] for neighbour in near_groups]))
        group_id += 1
    return list(active.values())


def _smallest_gaps(
    first_groups: list[_Group], second_groups: list[_Group]
) -> Float[np.ndarray, "p"]:
    """Return the gap between the two groups of each pair, (p,) mm.

    The gap is the smallest distance along the line between a track of the first group and a track
    of the second.
    """
    rows, first_pieces, second_pieces = [], [], []
    for row, (first_group, second_group) in enumerate(
        zip(first_groups, second_groups, strict=True)
    ):
        for piece in first_group.common_mm:
            rows.extend([row] * len(second_group.common_mm))
            first_pieces.extend([piece] * len(second_group.common_mm))
            second_pieces.extend(second_group.common_mm)
    smallest = np.full(len(first_groups), np.inf)
    np.minimum.at(smallest, rows, gap_mm(np.array(first_pieces), np.array(second_pieces)))
    return smallest


def _pair_log_odds(
    first_groups: list[_Group], second_groups: list[_Group], problem: _Problem
) -> Float[np.ndarray, "p"]:
    if not first_groups:
        return np.zeros(0)
    differences = difference(
        *(
            np.stack([getattr(group, field) for group in groups])
            for groups in (first_groups, second_groups)
            for field in ("ends_mm", "covariance_mm2")
        ),
        tuning=problem.tuning.evidence,
    )
    scale = problem.pieces.px_per_mm
    group_pairs = list(zip(first_groups, second_groups, strict=True))
    evidence = CollinearEvidence(
        differences,
        np.array([max(a.parallel_density, b.parallel_density) for a, b in group_pairs]),
        np.array([not a.segments.isdisjoint(b.segments) for a, b in group_pairs]),
        _smallest_gaps(first_groups, second_groups),
        np.array([scale[[*a.tracks, *b.tracks]].mean() for a, b in group_pairs]),
    )
    return collinear_log_odds(evidence, problem.scene, problem.tuning)


def _join_groups(first: _Group, second: _Group, problem: _Problem) -> _Group | None:
    """Fit one line to the segments of both groups; None if the line does not fit the segments."""
    tracks = tuple(sorted(first.tracks + second.tracks))
    longer = max(first, second, key=_length_mm)
    direction = longer.ends_mm[1] - longer.ends_mm[0]
    direction /= np.linalg.norm(direction)
    ends = np.concatenate([first.ends_mm, second.ends_mm])
    blocks = np.stack(
        [g.covariance_mm2[k : k + 3, k : k + 3] for g in (first, second) for k in (0, 3)]
    )
    positions = (ends - longer.ends_mm[0]) @ direction
    outer = [int(np.argmin(positions)), int(np.argmax(positions))]
    rules = problem.tuning.collinear
    start_ends = longer.ends_mm[0] + positions[outer, None] * direction
    fit = fit_line(collect_fragments(problem.pieces, tracks), start_ends, rules)
    is_consistent = chi_square_tail(fit.chi_square, fit.degrees) >= rules.significance
    if not (is_consistent and np.isfinite(fit.covariance_mm2).all()):
        return None
    direction = fit.ends_mm[1] - fit.ends_mm[0]
    direction /= np.linalg.norm(direction)
    covariance = fit.covariance_mm2.copy()
    for end in (0, 1):
        variance_along = direction @ blocks[outer[end]] @ direction
        covariance[3 * end : 3 * end + 3, 3 * end : 3 * end + 3] += variance_along * np.outer(
            direction, direction
        )
    parallel_density = max(first.parallel_density, second.parallel_density)
    return _Group(
        tracks,
        first.segments | second.segments,
        np.concatenate([first.common_mm, second.common_mm]),
        fit.ends_mm,
        covariance,
        fit.chi_square,
        fit.degrees,
        parallel_density,
        min(first.posterior, second.posterior),
    )


def _length_mm(group: _Group) -> float:
    return float(np.linalg.norm(group.ends_mm[1] - group.ends_mm[0]))


def _build_lines(
    groups: list[_Group],
    pieces: TrackTable,
    order: Int[np.ndarray, "t"],
    tail: float,
    rules: CollinearTuning,
) -> JoinedLines:
    """Build the result from the groups, sorted by the smallest track index of each group.

    `order` maps the tracks of `pieces` to the caller's track indices. `tail` is
    `Matches.noise_tail`, the inequality of the tracks' errors.
    """
    groups = sorted(groups, key=lambda group: int(order[list(group.tracks)].min()))
    group_ends = np.array([group.ends_mm for group in groups]).reshape(-1, 2, 3)
    blocks = np.array([group.covariance_mm2 for group in groups]).reshape(-1, 6, 6)
    fragments = [collect_fragments(pieces, group.tracks) for group in groups]
    posterior = np.array([group.posterior for group in groups])
    posteriors = line_posteriors(fragments, group_ends, posterior, tail, rules)
    line_of_track = np.zeros(len(order), dtype=np.int64)
    interval = np.zeros((len(order), 2))
    for line_id, group in enumerate(groups):
        tracks, ends = list(group.tracks), posteriors.ends_mm[line_id]
        step = ends[1] - ends[0]
        positions = (pieces.ends_mm[tracks] - ends[0]) @ (step / np.linalg.norm(step))
        line_of_track[order[tracks]], interval[order[tracks]] = line_id, np.sort(positions, axis=1)
    scale = [pieces.px_per_mm[list(group.tracks)].mean() for group in groups]
    return JoinedLines(
        posteriors.ends_mm,
        posteriors.covariance_mm2 + _project_along(posteriors.ends_mm, blocks),
        np.array([group.chi_square for group in groups]),
        np.array([group.degrees for group in groups], dtype=np.int64),
        line_of_track,
        interval,
        np.array(scale),
        posterior,
    )


def _project_along(
    ends_mm: Float[np.ndarray, "e 2 3"], covariance_mm2: Float[np.ndarray, "e 6 6"]
) -> Float[np.ndarray, "e 6 6"]:
    """Return the part of each covariance that lies along the line, separately for both ends."""
    direction = ends_mm[:, 1] - ends_mm[:, 0]
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    blocks = covariance_mm2.reshape(-1, 2, 3, 2, 3)
    variance = np.einsum("ni,neiej,nj->ne", direction, blocks, direction)
    spread = np.einsum("ne,ef,ni,nj->neifj", variance, np.eye(2), direction, direction)
    return spread.reshape(-1, 6, 6)
