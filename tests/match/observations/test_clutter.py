"""Clutter: as dense as it was strewn, as long as usual, and of no order or unit of its own."""

import numpy as np
import pytest

from tests.match.scene import MadeScene
from trinoc.match.observations.clutter import ClutterModel, fit_clutter
from trinoc.match.observations.table import SegmentTable

SIZE_PX = np.array([1000.0, 800.0])


def strewn(lines: SegmentTable, middle: list[np.ndarray], scale: float = 1.0) -> ClutterModel:
    """The clutter of segments of 20 px, about given middles."""
    size = max(len(m) for m in middle)
    ends = np.zeros((len(middle), size, 2, 2))
    for view, places in enumerate(middle):
        ends[view, : len(places)] = scale * (places[:, None] + np.array([[-10, 0], [10, 0]]))
    table = lines._replace(
        ends_px=ends,
        length_px=np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2),
        size_px=np.broadcast_to(scale * SIZE_PX, (len(middle), 2)),
    )
    return fit_clutter(table, [len(m) for m in middle])


@pytest.fixture(scope="module")
def places() -> list[np.ndarray]:
    """Evenly over the picture in two views, and a third of them in one corner in the last."""
    rng = np.random.default_rng(5)
    even = [rng.uniform(0, 1, (count, 2)) * SIZE_PX for count in (1200, 300, 600)]
    even[2][:200] = rng.uniform(0, 100, (200, 2))
    return even


def test_density_is_that_of_what_was_strewn(exact: MadeScene, places) -> None:
    clutter = strewn(exact.table, places)
    for view in (0, 1):
        stated = np.exp(clutter.log_density[view, : len(places[view])]) * np.pi
        expected = len(places[view]) / SIZE_PX.prod()
        # Never less than everywhere; and 25 neighbours vary by a fifth.
        assert stated.min() > 0.95 * expected
        assert 0.95 * expected < np.median(stated) < 1.2 * expected
    corner = np.exp(clutter.log_density[2, :200]) * np.pi
    assert abs(np.median(corner) / (200 / 100**2) - 1) < 0.25
    np.testing.assert_allclose(clutter.typical_px, 20.0)


def test_the_order_of_segments_changes_nothing(exact: MadeScene, places) -> None:
    clutter = strewn(exact.table, places)
    turn = [np.random.default_rng(v).permutation(len(p)) for v, p in enumerate(places)]
    again = strewn(exact.table, [p[t] for p, t in zip(places, turn, strict=True)])
    for view, order in enumerate(turn):
        np.testing.assert_allclose(
            again.log_density[view, : len(order)], clutter.log_density[view, order], atol=1e-12
        )


def test_larger_pixels_change_densities_by_their_area(exact: MadeScene, places) -> None:
    clutter, finer = strewn(exact.table, places), strewn(exact.table, places, scale=2.0)
    np.testing.assert_allclose(finer.log_density, clutter.log_density - np.log(4), atol=1e-9)
    np.testing.assert_allclose(finer.typical_px, 2 * clutter.typical_px)


def test_few_segments_or_none_have_the_density_of_the_picture(exact: MadeScene) -> None:
    few = [np.full((count, 2), 300.0) for count in (2, 1, 0)]
    clutter = strewn(exact.table, few)
    expected = np.log(np.array([2.0, 1.0, 1.0]) / SIZE_PX.prod() / np.pi)
    np.testing.assert_allclose(
        clutter.log_density, np.broadcast_to(expected[:, None], clutter.log_density.shape)
    )
    assert strewn(exact.table, [np.zeros((0, 2))] * 3).typical_px == 1.0
