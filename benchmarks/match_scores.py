"""Precision and recall of matched pairs and triples, for segments whose edges are known.

A pair or a triple of segments is right when its members come from one edge and their true
extents on it overlap. Precision is the share of what was put out that is right; recall is the
share found of the pairs (triples) whose common extent is at least a fifth of the shortest
member's, since shorter overlaps are chance.
"""

import itertools
from collections import defaultdict
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from trinoc.synth.truth import NOT_SCORED, SegmentTruth

LEAST_COMMON_SHARE = 0.2

# (view, segment) of each member, views in ascending order.
Group = tuple[tuple[int, int], ...]


class GroupScore(NamedTuple):
    """Precision and recall, and the numbers of published and of true groups."""

    precision: float
    recall: float
    put_out: int
    true: int


class MatchScore(NamedTuple):
    """Scores of the triples, and of all pairs, those within triples included."""

    triples: GroupScore
    pairs: GroupScore


def score_matches(matches: Any, truth: SegmentTruth) -> MatchScore:
    """Precision and recall of the triples and pairs of segments that tracks join.

    matches : any object with `views`, the names, and `index` (t, v), -1 where not matched.
    """
    rows = np.asarray(matches.index)
    members = (tuple((v, int(s)) for v, s in enumerate(row) if s >= 0) for row in rows)
    return score_groups(matches.views, members, truth)


def score_groups(
    views: tuple[str, ...], members: Iterable[Group], truth: SegmentTruth
) -> MatchScore:
    """Scores as of `score_matches`, for tracks as members (view's number in `views`, segment)."""
    put_out: dict[int, set[Group]] = {2: set(), 3: set()}
    for group in members:
        for size, groups in put_out.items():
            groups.update(itertools.combinations(group, size))
    scores = {
        size: _group_score(groups, _true_groups(views, truth, size), views, truth)
        for size, groups in put_out.items()
    }
    return MatchScore(triples=scores[3], pairs=scores[2])


def _group_score(
    put_out: set[Group], true: set[Group], views: tuple[str, ...], truth: SegmentTruth
) -> GroupScore:
    scored = [group for group in put_out if not _is_exempt(group, views, truth)]
    right = sum(_is_right(group, views, truth) for group in scored)
    return GroupScore(
        precision=right / len(scored) if scored else 0.0,
        recall=len(true & put_out) / len(true) if true else 0.0,
        put_out=len(scored),
        true=len(true),
    )


def _is_exempt(group: Group, views: tuple[str, ...], truth: SegmentTruth) -> bool:
    return all(truth.edge_of[views[view]][segment] == NOT_SCORED for view, segment in group)


def _is_right(group: Group, views: tuple[str, ...], truth: SegmentTruth) -> bool:
    edges = {int(truth.edge_of[views[view]][segment]) for view, segment in group}
    return len(edges) == 1 and min(edges) >= 0 and _common(group, views, truth)[0] > 0


def _common(group: Group, views: tuple[str, ...], truth: SegmentTruth) -> tuple[float, float]:
    """Length that the members' extents share, and length of the shortest, in edge lengths."""
    extents = np.sort([truth.extent[views[view]][segment] for view, segment in group], axis=1)
    shared = extents[:, 1].min() - extents[:, 0].max()
    return float(shared), float((extents[:, 1] - extents[:, 0]).min())


def _true_groups(views: tuple[str, ...], truth: SegmentTruth, size: int) -> set[Group]:
    members: defaultdict[int, list[list[tuple[int, int]]]] = defaultdict(
        lambda: [[] for _ in views]
    )
    for view, name in enumerate(views):
        for segment, edge in enumerate(truth.edge_of[name]):
            if edge >= 0:
                members[int(edge)][view].append((view, segment))
    groups = set()
    for by_view in members.values():
        for segment_lists in itertools.combinations(by_view, size):
            for group in itertools.product(*segment_lists):
                shared, shortest = _common(group, views, truth)
                if shared >= LEAST_COMMON_SHARE * shortest:
                    groups.add(group)
    return groups
