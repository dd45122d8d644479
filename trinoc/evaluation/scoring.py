"""Scores of matches and of 3-D lines against the truth.

A pair or a triple of segments is right when its members come from one edge and their true
extents on it overlap. Precision is the share of what was put out that is right; recall is the
share found of the pairs (triples) whose common extent is at least a fifth of the shortest
member's, since shorter overlaps are chance.
"""

import itertools
from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from trinoc.evaluation.distances import distance_to_segments_mm, sampled_segments
from trinoc.synth import (
    NOT_SCORED,
    SceneTruth,
    SegmentTruth,
    shown_parts_mm,
    shown_parts_of_segments_mm,
)

LEAST_COMMON_SHARE = 0.2
SAMPLE_STEP_MM = 0.5

# (view, segment) of each member, views in ascending order.
Group = tuple[tuple[int, int], ...]


@runtime_checkable
class TrackIndices(Protocol):
    """Matches as far as they are scored: names of the views and (t, v) index, -1 not seen."""

    @property
    def views(self) -> tuple[str, ...]:
        """Names of the views, the order of axis v."""
        ...

    @property
    def index(self) -> Int[np.ndarray, "t v"]:
        """The segment of each view on each track, -1 where not seen."""
        ...


class GroupScore(NamedTuple):
    """Shares right and found, and how many were put out and are true."""

    precision: float
    recall: float
    put_out: int
    true: int


class MatchScore(NamedTuple):
    """Scores of the triples, and of all pairs, those within triples included."""

    triples: GroupScore
    pairs: GroupScore


class LengthScore(NamedTuple):
    """Share of the length put out that is right, share of the true length that was found."""

    precision: float
    recall: float
    length_put_out_mm: float
    length_true_mm: float


def score_matches(matches: TrackIndices, truth: SegmentTruth) -> MatchScore:
    """Precision and recall of the triples and pairs of views that the tracks join."""
    rows = np.asarray(matches.index)
    return score_groups(
        matches.views,
        (
            tuple((view, int(segment)) for view, segment in enumerate(row) if segment >= 0)
            for row in rows
        ),
        truth,
    )


def score_groups(
    views: tuple[str, ...], members: Iterable[Group], truth: SegmentTruth
) -> MatchScore:
    """As `score_matches`, for tracks given as members (view's number in `views`, segment)."""
    put_out: dict[int, set[Group]] = {2: set(), 3: set()}
    for group in members:
        for size, found in put_out.items():
            found.update(itertools.combinations(group, size))
    scores = {
        size: _group_score(found, _true_groups(views, truth, size), views, truth)
        for size, found in put_out.items()
    }
    return MatchScore(triples=scores[3], pairs=scores[2])


def score_lengths(
    lines_mm: Float[np.ndarray, "t 2 3"],
    truth: SceneTruth | SegmentTruth,
    *,
    tolerance_mm: float = 1.0,
    views: int = 2,
    grey_step: float = 0.0,
    kinds: tuple[str, ...] | None = None,
) -> LengthScore:
    """Precision and recall by length, at a distance.

    Precision: the share of the length of `lines_mm` within `tolerance_mm` of a true edge.
    Recall: the share, within `tolerance_mm` of a line put out, of what could be found: the
    parts of edges that at least `views` pictures show, with grey levels that differ by
    `grey_step` across them where pictures are known; of edges of `kinds`, None being all.
    Both are 0 where there is nothing. Samples are at most half a millimetre apart.
    """
    if isinstance(truth, SegmentTruth):
        shown = shown_parts_of_segments_mm(truth, views=views)
    else:
        shown = shown_parts_mm(truth, views=views, grey_step=grey_step, kinds=kinds)
    lines = np.asarray(lines_mm, dtype=np.float64).reshape(-1, 2, 3)
    precision, put_out = _share_near(lines, truth.edges_mm, tolerance_mm)
    recall, true = _share_near(shown, lines, tolerance_mm)
    return LengthScore(precision, recall, put_out, true)


def line_errors(
    lines_mm: Float[np.ndarray, "t 2 3"], matches: TrackIndices, truth: SegmentTruth
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Distance in mm (rms of the two ends, across the edge) and angle in degrees of lines from
    their edge; of the lines of which two or more segments, and the most, come from one edge."""
    distances, angles = [], []
    for line, row in zip(lines_mm, np.asarray(matches.index), strict=True):
        owners = [
            int(truth.edge_of[view][segment])
            for view, segment in zip(matches.views, row, strict=True)
            if segment >= 0
        ]
        edges, votes = np.unique(owners, return_counts=True)
        if edges[votes.argmax()] < 0 or votes.max() < 2:
            continue
        first, second = truth.edges_mm[edges[votes.argmax()]]
        along = (second - first) / np.linalg.norm(second - first)
        offset = line - first
        across = offset - (offset @ along)[:, None] * along
        distances.append(np.sqrt(np.mean(np.sum(across**2, axis=1))))
        direction = line[1] - line[0]
        sine = np.linalg.norm(np.cross(direction, along))
        angles.append(np.degrees(np.arctan2(sine, abs(direction @ along))))
    return np.array(distances), np.array(angles)


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
    """Length that the members' extents share, and that of the shortest, in parts of the edge."""
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
        for chosen in itertools.combinations(by_view, size):
            for group in itertools.product(*chosen):
                shared, shortest = _common(group, views, truth)
                if shared >= LEAST_COMMON_SHARE * shortest:
                    groups.add(group)
    return groups


def _share_near(
    segments_mm: Float[np.ndarray, "n 2 3"],
    others_mm: Float[np.ndarray, "m 2 3"],
    tolerance_mm: float,
) -> tuple[float, float]:
    """Share of the length of segments that lies near any of the others, and that length."""
    points, weights = sampled_segments(segments_mm, SAMPLE_STEP_MM)
    total = float(weights.sum())
    if total == 0 or len(others_mm) == 0:
        return 0.0, total
    near = distance_to_segments_mm(points, others_mm) < tolerance_mm
    return float(weights[near].sum()) / total, total
