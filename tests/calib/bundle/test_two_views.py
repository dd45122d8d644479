"""A line that two views show goes through both fragments, wherever it was before."""

import jax
import numpy as np

from tests.calib.bundle.made_tracks import made_tracks
from tests.calib.bundle.test_reduced_system import states, tracks_of
from trinoc.calib.bundle.schur import squared_distances
from trinoc.calib.bundle.two_view_lines import placed_by_two_views
from trinoc.geometry import PoseModel


def test_two_views_are_met_exactly_and_others_stay():
    lines, ends, _ = made_tracks(4, 60, hidden=0.5)
    cameras, _ = states(PoseModel.AIMED)
    tracks = tracks_of(lines)
    start = ends + np.random.default_rng(5).normal(0.0, 3.0, ends.shape)
    placed = np.asarray(jax.jit(placed_by_two_views)(cameras, start, tracks))
    two = lines.seen.sum(axis=1) == 2
    assert 10 < two.sum() < 50
    squared = np.asarray(jax.jit(squared_distances)(cameras, placed, tracks))
    before = np.asarray(jax.jit(squared_distances)(cameras, start, tracks))
    assert before[two].sum(axis=1).min() > 1.0
    np.testing.assert_allclose(squared[two], 0.0, atol=1e-8)
    np.testing.assert_array_equal(placed[~two], start[~two])


def test_the_point_of_the_line_nearest_to_the_anchor_is_taken():
    lines, ends, _ = made_tracks(4, 60, hidden=0.5)
    cameras, _ = states(PoseModel.AIMED)
    place = jax.jit(placed_by_two_views)
    once = np.asarray(place(cameras, ends, tracks_of(lines)))
    two = lines.seen.sum(axis=1) == 2
    way = once[two, 1] - once[two, 0]
    across = np.einsum("tei,ti->te", ends[two] - once[two], way)
    np.testing.assert_allclose(across, 0.0, atol=1e-6)
    np.testing.assert_allclose(place(cameras, once, tracks_of(lines)), once, atol=1e-7)
