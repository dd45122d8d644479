"""The search returns exactly the triples that pass the gate."""

import jax
import numpy as np
import pytest

from tests.match.scene import VIEWS, MadeScene, made_scene
from trinoc.match.candidates.index import index_segments
from trinoc.match.candidates.search import gate_triples, passes_third_view_gate
from trinoc.match.candidates.third_view import (
    predict,
    prepare_order,
    third_view,
)
from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.two_view.epipolar_pencil import build_pencil, take_segments

ORDER, COUNT = np.arange(3), 30


def found_triples(scene: MadeScene) -> set[tuple[int, ...]]:
    lines = scene.inputs.lines
    inputs = prepare_order(lines, ORDER)[1]
    i, j = np.divmod(np.arange(COUNT * COUNT, dtype=np.int32), COUNT)
    table = index_segments(lines, 2, COUNT)
    index = gate_triples(lines, inputs, table, i, j, DEFAULT.candidates)
    assert len(np.unique(index, axis=0)) == len(index)
    return {tuple(row) for row in index.tolist()}


@jax.jit
def passes_gate(lines: SegmentTable, triple):
    planes = build_pencil(lines, ORDER[0], ORDER[1])
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
def test_all_true_triples_that_the_gate_passes_are_found(sigma_px: float) -> None:
    scene = made_scene(*VIEWS, count=COUNT, seed=5, noise_px=0.5 * sigma_px, sigma_px=sigma_px)
    _, passes = (np.asarray(x) for x in passes_gate(scene.inputs.lines, scene.true))
    assert passes.sum() >= 5
    assert found_triples(scene) >= {tuple(row) for row in scene.true[passes].tolist()}


def test_what_is_found_passes_gate_precision_too(noisy: MadeScene) -> None:
    index = np.array(sorted(found_triples(noisy)), dtype=np.int32)[:COUNT]
    assert len(index) >= 20
    _, passes = (np.asarray(x) for x in passes_gate(noisy.inputs.lines, index))
    assert passes.all()
