"""Step 1: triples of segments that can be one line, from all three orderings of the views."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates.judged import candidates_of
from trinoc.match.candidates.lookup import lookup
from trinoc.match.candidates.search import gated_triples
from trinoc.match.candidates.single_precision import prepared_order
from trinoc.match.candidates.table import Candidates, no_candidates, prior_log_odds
from trinoc.match.evidence import prior_parameters
from trinoc.match.observations import ClutterModel, SegmentTable
from trinoc.match.tuning import DEFAULT, MatchTuning
from trinoc.match.two_view import Pencil, plane_angles
from trinoc.numerics import ArrayLike, blocks, concatenate_rows, overlapping

# About as many pairs are held at a time.
PAIRS_AT_A_TIME = 1 << 19


def trinocular_candidates(
    lines: SegmentTable,
    views: tuple[int, int, int],
    counts: list[int],
    clutter: ClutterModel,
    tuning: MatchTuning = DEFAULT,
) -> Candidates:
    """All triples of three views; each is found from the pair of views that crosses best."""
    # Tables of three views, whichever and of how many, so that kernels compile once for all.
    three, own = lines, clutter
    if views != tuple(range(len(counts))):
        three, own = _views_of(lines, clutter, np.array(views))
    numbers = [counts[view] for view in views]
    parts, known = [no_candidates(3)], np.zeros(0, np.int64)
    for turn in range(3):
        here = [known]
        for number, part in _in_order(
            three, np.roll(np.arange(3), turn), numbers, own, known, tuning
        ):
            here.append(number)
            parts.append(part)
            if sum(len(found.index) for found in parts) > tuning.candidates.most_candidates:
                parts = [_likelier_half(concatenate_rows(parts), numbers, tuning)]
        known = np.sort(np.concatenate(here))
    found = concatenate_rows(parts)
    found = found.take(np.argsort(_number_of(found.index, numbers)))
    index = np.full((len(found.index), len(counts)), -1)
    interval = np.zeros((len(found.index), len(counts), 2))
    index[:, views], interval[:, views] = found.index, found.interval
    return found._replace(index=index, interval=interval)


def _number_of(index: Int[np.ndarray, "m 3"], counts: list[int]) -> Int[np.ndarray, "m"]:
    """A number of its own for each triple."""
    i, j, k = index.T.astype(np.int64)
    return (i * counts[1] + j) * counts[2] + k


@jax.jit
def _views_of(
    lines: SegmentTable, clutter: ClutterModel, views: Int[ArrayLike, "k"]
) -> tuple[SegmentTable, ClutterModel]:
    densities = jnp.asarray(clutter.log_density)[views]
    cameras = ("matrix_px", "centre_mm", "inverse", "size_px")
    shapes = {name: getattr(lines, name) for name in cameras}
    if lines.frame is not None:
        shapes = {name: jnp.moveaxis(column, 1, 0) for name, column in shapes.items()}
    three = jax.tree.map(lambda table: table[views], lines._replace(**shapes))
    if lines.frame is not None:
        moved = {name: jnp.moveaxis(getattr(three, name), 0, 1) for name in cameras}
        three = three._replace(**moved)
    return three, ClutterModel(densities, clutter.typical_px)


def _in_order(
    lines: SegmentTable,
    order: Int[np.ndarray, "3"],
    counts: list[int],
    clutter: ClutterModel,
    known: Int[np.ndarray, "t"],
    tuning: MatchTuning,
) -> Iterator[tuple[Int[np.ndarray, "_"], Candidates]]:
    """(numbers of triples, those that may be likely) of which the first two views predict the third
    segment, but those `known`: two orderings find one triple where they cross about as well."""
    typical = float(np.mean([counts[view] for view in order]))
    table = lookup(lines, int(order[2]), counts[order[2]], tuning.candidates)
    planes, single = prepared_order(lines, order)
    for i, j in _pairs(lines, order, planes, counts):
        triple = gated_triples(lines, single, table, i, j, tuning.candidates)
        if len(known):
            number = _number_of(triple[:, np.argsort(order)], counts)
            place = np.minimum(np.searchsorted(known, number), len(known) - 1)
            triple = triple[known[place] != number]
        found = candidates_of(lines, order, planes, triple, clutter, tuning)
        # Frames of a stack are small.
        many = lines.frame is None and len(found.index) > tuning.candidates.prune_above
        number = _number_of(found.index, counts)
        yield number, _pruned(found, typical, tuning) if many else found


def _pruned(found: Candidates, typical_count: float, tuning: MatchTuning) -> Candidates:
    """Those that may yet be likely: most of what passes the gate is not, and takes memory."""
    odds = _odds_anywhere(found, typical_count, tuning)
    return found.take(odds > tuning.candidates.prune_log_odds)


def _likelier_half(found: Candidates, counts: list[int], tuning: MatchTuning) -> Candidates:
    odds = _odds_anywhere(found, float(np.mean(counts)), tuning)
    return found.take(odds > np.median(odds))


def _odds_anywhere(
    found: Candidates, typical_count: float, tuning: MatchTuning
) -> Float[np.ndarray, "m"]:
    mixture = prior_parameters(found.ends_mm, typical_count, tuning)
    # One block shows how large the volume is, but not yet where lines lie in it.
    everywhere = mixture.volume._replace(precision=np.zeros((3, 3)))
    return prior_log_odds(found, mixture._replace(volume=everywhere), tuning.evidence)


def _pairs(
    lines: SegmentTable, order: Int[np.ndarray, "3"], planes: Pencil, counts: list[int]
) -> Iterator[tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]]:
    """Pairs that share epipolar planes, in blocks of segments of the first view."""
    angles_a, angles_b = (
        plane_angles(lines, int(view), segments)[: counts[view]]
        for view, segments in zip(order[:2], (planes.first, planes.second), strict=True)
    )
    frames = 1 if lines.frame is None else 1 + int(np.max(lines.frame))
    # About one in four pairs of a frame shares epipolar planes.
    rows = max(1, 4 * PAIRS_AT_A_TIME * frames // max(counts[order[1]], 1))
    for block in blocks(counts[order[0]], rows):
        i, j = overlapping(angles_a[block], angles_b)
        yield (i + block.start).astype(np.int32), j.astype(np.int32)
