"""Pairs of nearby ends agree with a full table of distances."""

import numpy as np
import pytest

from trinoc.match.selection.junction_support import _pairs_of_near_ends_in_frames
from trinoc.match.selection.marginals import residual_scale


def test_places_within_the_reach_are_those_that_a_full_table_of_distances_has():
    random = np.random.default_rng(0)
    points, frame = random.uniform(0, 6, size=(200, 3)), random.integers(0, 2, size=200)
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    is_near = (distance <= 1) & (frame[:, None] == frame)
    pairs = {frozenset(pair) for pair in _pairs_of_near_ends_in_frames(points, frame).tolist()}
    assert pairs == {frozenset(pair) for pair in np.argwhere(np.triu(is_near, 1)).tolist()}


def test_without_triples_segments_err_as_they_state():
    none = np.zeros((3, 0, 2, 2))
    np.testing.assert_allclose(residual_scale([], none, frames=3), 1.0, atol=0.03)
    assert residual_scale([], none) == pytest.approx(1.0, abs=0.03)
