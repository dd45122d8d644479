"""The search in single precision finds what the gate in double precision passes."""

import jax
import numpy as np
import pytest

from tests.match.scene import VIEWS, MadeScene, made_scene
from trinoc.match.candidates.index import lookup
from trinoc.match.candidates.search import gate_triples, passes_third_view_gate
from trinoc.match.candidates.single_precision import (
    predict,
    prepare_order,
    rounding_px,
    third_view,
)
from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.two_view.epipolar_pencil import pencil, take_segments

ORDER, COUNT = np.arange(3), 30


def found_in_single(scene: MadeScene) -> set[tuple[int, ...]]:
    lines = scene.seen.lines
    single = prepare_order(lines, ORDER)[1]
    assert single.segments.dtype == single.first.low.dtype == np.float32
    i, j = np.divmod(np.arange(COUNT * COUNT, dtype=np.int32), COUNT)
    table = lookup(lines, 2, COUNT)
    found = gate_triples(lines, single, table, i, j, DEFAULT.candidates)
    assert len(np.unique(found, axis=0)) == len(found)
    return {tuple(row) for row in found.tolist()}


@jax.jit
def passes_in_double(lines: SegmentTable, triple):
    planes = pencil(lines, ORDER[0], ORDER[1])
    view = third_view(lines, planes, ORDER[2])

    def one(index):
        guess = predict(
            view, take_segments(planes.first, index[0]), take_segments(planes.second, index[1])
        )
        k = index[2]
        columns = lines.ends_px[2, k], lines.line[2, k], lines.across_px2[2, k]
        return guess.possible, passes_third_view_gate(guess, *columns)

    return jax.vmap(one)(triple)


@pytest.mark.parametrize("sigma_px", [0.3, 1e-5])
def test_all_true_triples_that_double_precision_passes_are_found(sigma_px: float) -> None:
    scene = made_scene(*VIEWS, count=COUNT, seed=5, noise_px=0.5 * sigma_px, sigma_px=sigma_px)
    _, passes = (np.asarray(x) for x in passes_in_double(scene.seen.lines, scene.true))
    assert passes.sum() >= 5
    assert found_in_single(scene) >= {tuple(row) for row in scene.true[passes].tolist()}


def test_what_is_found_passes_in_double_precision_too(noisy: MadeScene) -> None:
    found = np.array(sorted(found_in_single(noisy)), dtype=np.int32)[:COUNT]
    assert len(found) >= 20
    _, passes = (np.asarray(x) for x in passes_in_double(noisy.seen.lines, found))
    assert passes.mean() > 0.95


def test_rounding_is_far_below_the_errors_of_segments(noisy: MadeScene) -> None:
    assert 0 < float(rounding_px(noisy.seen.lines.matrix_px, 2)) < 0.02
