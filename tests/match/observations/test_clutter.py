"""Clutter: its density and length are those of the segments, whatever the order and the unit."""

import numpy as np
import pytest

from tests.match.scene import MadeScene
from trinoc.match.observations.clutter import ClutterModel, fit_clutter
from trinoc.match.observations.table import SegmentTable

SIZE_PX = np.array([1000.0, 800.0])


def strewn(lines: SegmentTable, middles: list[np.ndarray], scale: float = 1.0) -> ClutterModel:
    """Clutter model of segments of 20 px about these middles."""
    size = max(len(m) for m in middles)
    ends = np.zeros((len(middles), size, 2, 2))
    for view, view_middles in enumerate(middles):
        ends[view, : len(view_middles)] = scale * (
            view_middles[:, None] + np.array([[-10, 0], [10, 0]])
        )
    table = lines._replace(
        ends_px=ends,
        length_px=np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2),
        size_px=np.broadcast_to(scale * SIZE_PX, (len(middles), 2)),
    )
    return fit_clutter(table, [len(m) for m in middles])


@pytest.fixture(scope="module")
def middles_px() -> list[np.ndarray]:
    """Middles, even over the picture in two views; in the third view one third lie in a corner."""
    rng = np.random.default_rng(5)
    even = [rng.uniform(0, 1, (count, 2)) * SIZE_PX for count in (1200, 300, 600)]
    even[2][:200] = rng.uniform(0, 100, (200, 2))
    return even


def test_density_is_that_of_what_was_strewn(exact: MadeScene, middles_px) -> None:
    clutter = strewn(exact.table, middles_px)
    for view in (0, 1):
        stated = np.exp(clutter.log_density[view, : len(middles_px[view])]) * np.pi
        expected = len(middles_px[view]) / SIZE_PX.prod()
        # Never less than everywhere; and 25 neighbours vary by a fifth.
        assert stated.min() > 0.95 * expected
        assert 0.95 * expected < np.median(stated) < 1.2 * expected
    corner = np.exp(clutter.log_density[2, :200]) * np.pi
    assert abs(np.median(corner) / (200 / 100**2) - 1) < 0.25
    np.testing.assert_allclose(clutter.typical_px, 20.0)


def test_the_order_of_segments_changes_nothing(exact: MadeScene, middles_px) -> None:
    clutter = strewn(exact.table, middles_px)
    turn = [np.random.default_rng(v).permutation(len(p)) for v, p in enumerate(middles_px)]
    reordered = strewn(exact.table, [p[t] for p, t in zip(middles_px, turn, strict=True)])
    for view, order in enumerate(turn):
        np.testing.assert_allclose(
            reordered.log_density[view, : len(order)], clutter.log_density[view, order], atol=1e-12
        )


def test_larger_pixels_change_densities_by_their_area(exact: MadeScene, middles_px) -> None:
    clutter, finer = strewn(exact.table, middles_px), strewn(exact.table, middles_px, scale=2.0)
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
