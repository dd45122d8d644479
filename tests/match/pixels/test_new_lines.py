"""Laws of what chooses lines that may be there: quick look, families."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.match.pixels.test_evidence import noise_picture, probes, seen, step_edge
from trinoc.match.pixels.new_lines import mask_segments, quick_look
from trinoc.match.pixels.partners import first_of_each, parallel_families


def test_a_quick_look_sees_edges_and_neither_noise_nor_what_crosses():
    edge = step_edge(0.4, contrast=12, noise=2.0, seed=1)
    picture = seen(edge.picture)
    middle = edge.ends_px.mean(axis=0)
    across = (edge.ends_px - middle)[:, ::-1] * np.array([1, -1]) + middle
    own, turned, crossing = quick_look(
        picture, np.stack([edge.ends_px, edge.ends_px[::-1], across])
    )
    assert own > 2.0
    assert own == pytest.approx(turned, abs=0.2)
    assert crossing < 1.2
    empty = quick_look(seen(noise_picture("white")), probes(512, 60, 3))
    assert (empty < 1.5).mean() > 0.9
    assert (empty >= 0).all()


def test_a_quick_look_is_the_same_at_any_number_of_probes():
    picture, asked = seen(noise_picture("texture")), probes(16, 60, 3)
    few = quick_look(picture, asked)
    many = quick_look(picture, np.tile(asked, (2100, 1, 1)))
    np.testing.assert_array_equal(many, np.tile(few, 2100))
    assert len(quick_look(picture, asked[:0])) == 0


def test_what_matched_segments_show_is_not_new():
    edge = step_edge(0.4, contrast=40, noise=1.0, seed=1)
    picture = seen(edge.picture)
    rest = mask_segments(picture, edge.ends_px[None], 9)
    assert quick_look(picture, edge.ends_px[None])[0] > 2.5
    assert quick_look(rest, edge.ends_px[None])[0] < 0.5
    far = quick_look(rest, edge.ends_px[None] + 40) - quick_look(picture, edge.ends_px[None] + 40)
    assert far[0] == 0


@given(st.integers(0, 2**32 - 1))
def test_families_hold_what_is_parallel_to_their_longest(seed):
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(30, 3)) * np.array([1, 0.1, 0.02])
    length = np.linalg.norm(way, axis=1)
    unit = way / length[:, None]
    family = parallel_families(unit, length, 4.0)
    np.testing.assert_array_equal(family, parallel_families(-unit, length, 4.0))
    for k in range(family.max() + 1):
        own = np.flatnonzero(family == k)
        longest = own[length[own].argmax()]
        assert (np.abs(unit[own] @ unit[longest]) > np.cos(np.radians(4.0)) - 1e-12).all()
        # No later family's longest is parallel to it.
        later = [np.flatnonzero(family == j) for j in range(k + 1, family.max() + 1)]
        leaders = [rows[length[rows].argmax()] for rows in later]
        assert all(abs(unit[row] @ unit[longest]) < 0.998 for row in leaders)


def test_first_of_each_key():
    assert first_of_each(np.array([3, 1, 3, 2, 1])).tolist() == [0, 1, 3]
