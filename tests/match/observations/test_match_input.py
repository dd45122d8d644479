"""The matcher's own order does not depend on the caller's order."""

import dataclasses

import jax
import numpy as np
import pytest

from tests.match.made import rig_of
from tests.match.scene import VIEWS, MadeScene
from trinoc.errors import MatchError
from trinoc.geometry import distort_pixels, undistort_pixels
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.observations.match_input import MAX_SEGMENTS, MatchInput, prepare

Pictures = dict[str, Segments]


@pytest.fixture(scope="module")
def segments(noisy: MadeScene) -> Pictures:
    """Segments with ends of unequal covariance, darker sides and levels."""
    rng, result = np.random.default_rng(7), {}
    for name, ends in noisy.pictures_px.items():
        table = Segments.from_endpoints(ends)
        root = rng.normal(size=(len(ends), 4, 4))
        levels = rng.uniform(20, 220, (len(ends), 2))
        levels[::2] = np.nan
        result[name] = dataclasses.replace(
            table,
            covariance_px2=0.1 * (root @ root.mT) + 0.05 * np.eye(4),
            polarity=rng.integers(-1, 2, len(ends)),
            side_levels=levels,
        )
    return result


@pytest.fixture(scope="module")
def inputs(noisy: MadeScene, segments: Pictures) -> MatchInput:
    return prepare(segments, noisy.rig, None)


def turned(table: Segments, order: np.ndarray, swap: np.ndarray) -> Segments:
    """The same segments in another order, some with their ends exchanged."""
    s = jax.tree.map(lambda field: field[order], table)
    covariance = s.covariance_px2.reshape(-1, 2, 2, 2, 2)[:, ::-1, :, ::-1].reshape(-1, 4, 4)
    return dataclasses.replace(
        s,
        endpoints_px=np.where(swap[:, None, None], s.endpoints_px[:, ::-1], s.endpoints_px),
        covariance_px2=np.where(swap[:, None, None], covariance, s.covariance_px2),
        polarity=np.where(swap, -s.polarity, s.polarity),
        side_levels=np.where(swap[:, None], s.side_levels[:, ::-1], s.side_levels),
    )


def test_order_of_segments_ends_and_views_changes_nothing(
    noisy: MadeScene, segments: Pictures, inputs: MatchInput
) -> None:
    rng = np.random.default_rng(2)
    ranks = {name: rng.permutation(30) for name in VIEWS}
    reordered = prepare(
        {name: turned(segments[name], ranks[name], rng.random(30) < 0.5) for name in VIEWS[::-1]},
        Rig({name: noisy.rig[name] for name in VIEWS[::-1]}),
        None,
    )
    assert reordered.names == inputs.names
    for one, other in zip(inputs.lines, reordered.lines, strict=True):
        np.testing.assert_array_equal(one, other)
    for view, name in enumerate(inputs.names):
        np.testing.assert_array_equal(ranks[name][reordered.order[view]], inputs.order[view])
        np.testing.assert_array_equal(reordered.covariance_px2[view], inputs.covariance_px2[view])


def test_the_caller_s_numbers_lead_back_to_the_segments(
    segments: Pictures, inputs: MatchInput
) -> None:
    for view, name in enumerate(inputs.names):
        ends = np.asarray(segments[name].endpoints_px)[inputs.order[view]]
        np.testing.assert_array_equal(np.sort(ends, axis=1), np.sort(inputs.ends_px[view], axis=1))
        assert (inputs.ends_px[view][:, 0, 0] <= inputs.ends_px[view][:, 1, 0]).all()
    assert inputs.counts == [30, 30, 30]


def test_tables_hold_what_they_say(noisy: MadeScene, inputs: MatchInput) -> None:
    table = jax.tree.map(np.asarray, inputs.lines)
    np.testing.assert_allclose(np.linalg.norm(table.matrix_px[:, 2, :3], axis=1), 1.0)
    for view, name in enumerate(inputs.names):
        camera = noisy.rig[name]
        np.testing.assert_allclose(table.centre_mm[view], camera.centre_world_mm, atol=1e-8)
        np.testing.assert_allclose(
            table.inverse[view] @ table.matrix_px[view, :, :3], np.eye(3), atol=1e-10
        )
        ends, line = table.ends_px[view, :30], table.line[view, :30]
        off = (ends * line[:, None, :2]).sum(-1) + line[:, 2:]
        np.testing.assert_allclose(off, 0, atol=1e-9)
        # Errors of each end across the segment, from the covariance of all four coordinates.
        across = np.zeros((30, 2, 4))
        across[:, 0, :2] = across[:, 1, 2:] = line[:, :2]
        expected = across @ inputs.covariance_px2[view] @ across.mT
        np.testing.assert_allclose(table.across_px2[view, :30], expected, atol=1e-12)
        image = table.rays[view] @ table.matrix_px[view, :, :3].T
        np.testing.assert_allclose(image[..., :2] / image[..., 2:], table.ends_px[view], atol=1e-7)


def test_a_darker_side_is_no_evidence_beside_the_levels_that_show_it(segments, inputs) -> None:
    polarity = np.asarray(inputs.lines.polarity)
    for view, name in enumerate(inputs.names):
        order = inputs.order[view]
        of_levels = np.isfinite(np.asarray(segments[name].side_levels)[order]).all(axis=1)
        stated = np.asarray(segments[name].polarity)[order]
        assert of_levels.any()
        assert (polarity[view, :30][of_levels] == 0).all()
        np.testing.assert_array_equal(
            np.abs(polarity[view, :30][~of_levels]), np.abs(stated[~of_levels])
        )


def test_a_stated_sigma_takes_the_place_of_the_segments_own(noisy: MadeScene, segments) -> None:
    table = prepare(segments, noisy.rig, 0.25).lines
    expected = np.broadcast_to(0.0625 * np.eye(2), (3, 30, 2, 2))
    np.testing.assert_allclose(np.asarray(table.across_px2)[:, :30], expected, atol=1e-12)


def test_distortion_is_taken_out_and_put_back(noisy: MadeScene) -> None:
    lens = rig_of("upper", distortion=(-0.2, 0.05))["upper"].intrinsics
    ends = np.asarray(noisy.inputs.ends_px[0])
    bent = distort_pixels(lens, ends)
    assert np.abs(bent - ends).max() > 0.5
    np.testing.assert_allclose(undistort_pixels(lens, bent), ends, atol=1e-6)
    plain = noisy.rig["upper"].intrinsics
    np.testing.assert_array_equal(undistort_pixels(plain, ends), ends)
    assert distort_pixels(lens, ends[:0]).shape == (0, 2, 2)


def test_more_segments_than_memory_bears_are_refused() -> None:
    many = np.random.default_rng(0).uniform(0, 400, (MAX_SEGMENTS + 1, 4))
    with pytest.raises(MatchError, match="at most 40000 segments per view"):
        prepare({"upper": many[:9], "left": many}, rig_of("upper", "left"), None)
