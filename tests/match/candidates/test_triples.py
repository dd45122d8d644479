"""Step 1 returns the triples of an exhaustive search, whatever the order of the views."""

import numpy as np
import pytest

from tests.match.candidates.dense_matcher import match_densely
from tests.match.scene import MadeScene
from trinoc.match.candidates.table import Candidates, in_depth_range
from trinoc.match.candidates.triples import trinocular_candidates
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.tuning.every_group import DEFAULT

GATE = DEFAULT.candidates.gate


def as_set(index: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(row) for row in index.tolist()}


def test_true_triples_are_candidates(noisy: MadeScene, triples: Candidates) -> None:
    assert as_set(triples.index) >= as_set(noisy.true)


def test_what_the_dense_search_takes_are_candidates(noisy: MadeScene, triples: Candidates) -> None:
    ends = [np.asarray(view) for view in noisy.inputs.ends_px]
    taken = match_densely(ends, noisy.table.matrix_px, sigma_px=0.3)
    assert len(taken) >= 20
    assert as_set(triples.index) >= as_set(taken)


def test_no_triple_comes_twice_or_beyond_the_gate(triples: Candidates) -> None:
    assert len(as_set(triples.index)) == len(triples.index)
    assert (triples.chi_square < GATE).all()
    for field in (triples.interval, triples.ends_mm, triples.log_density, triples.end_log):
        assert np.isfinite(field).all()


@pytest.mark.parametrize("views", [(1, 2, 0), (2, 1, 0)])
def test_the_order_of_views_changes_nothing(
    noisy: MadeScene, clutter: ClutterModel, triples: Candidates, views: tuple[int, int, int]
) -> None:
    reordered = trinocular_candidates(noisy.inputs.lines, views, noisy.inputs.counts, clutter)
    assert as_set(reordered.index) == as_set(triples.index)
    one, other = (np.lexsort(candidates.index.T) for candidates in (triples, reordered))
    np.testing.assert_allclose(
        reordered.chi_square[other], triples.chi_square[one], rtol=0.05, atol=0.01
    )
    np.testing.assert_allclose(reordered.log_density[other], triples.log_density[one], atol=0.05)


def test_ends_in_space_are_those_of_the_lines(exact: MadeScene, clutter: ClutterModel) -> None:
    candidates = trinocular_candidates(exact.inputs.lines, (0, 1, 2), exact.inputs.counts, clutter)
    row = {tuple(index): n for n, index in enumerate(candidates.index.tolist())}
    true = [row[tuple(index)] for index in exact.true.tolist()]
    ends = candidates.ends_mm[true]
    swap = ((ends - exact.lines_mm) ** 2).sum((1, 2)) > 1.0
    ends = np.where(swap[:, None, None], ends[:, ::-1], ends)
    np.testing.assert_allclose(ends, exact.lines_mm, atol=1e-5)
    np.testing.assert_allclose(candidates.chi_square[true], 0, atol=1e-9)


def test_depths_are_those_before_each_camera(noisy: MadeScene, triples: Candidates) -> None:
    matrices = noisy.rig.matrices_px
    scale = np.linalg.norm(matrices[:, 2, :3], axis=1)
    third = matrices[:, 2] / scale[:, None]
    depth = triples.ends_mm @ third[:, :3].T + third[:, 3]
    low, high = float(np.quantile(depth, 0.1)), float(np.quantile(depth, 0.9))
    expected = ((depth > low) & (depth < high)).all(axis=(1, 2))
    in_range = in_depth_range(triples, noisy.inputs.lines, (low, high))
    np.testing.assert_array_equal(in_range, expected)
