"""Evidence of the positions of pairs: the integral over all lines, whatever the view order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.match.evidence.line_integral import log_evidence
from tests.match.scene import MadeScene, image_px
from trinoc.match.evidence.triple_position import PairEvidence, pair_evidence
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.two_view.epipolar_pencil import build_pencil, take_segments

AGREEING_PX = np.array(DEFAULT.ends.agreement_px)

VIEWS = np.array([0, 2])


@jax.jit
def evidence_of(lines, views, segments, clutter) -> PairEvidence:
    planes = build_pencil(lines, views[0], views[1])

    def one(segments):
        rows = take_segments(planes.first, segments[0]), take_segments(planes.second, segments[1])
        return pair_evidence(lines, views, planes, rows, segments, clutter)

    return jax.tree.map(jnp.asarray, jax.vmap(one)(segments))


@pytest.fixture(scope="module")
def evidence(precise: MadeScene, clutter: ClutterModel) -> PairEvidence:
    """Evidence of the true pairs."""
    true_pairs = evidence_of(precise.inputs.lines, VIEWS, precise.true[:, VIEWS], clutter)
    return jax.tree.map(np.asarray, true_pairs)


def ends_of(points: tuple) -> np.ndarray:
    return np.moveaxis(np.array(points), 2, 0)


def test_evidence_is_the_integral_over_all_lines(
    precise: MadeScene, clutter: ClutterModel, evidence: PairEvidence
) -> None:
    table, ends_mm, typical = precise.table, ends_of(evidence.ends_mm), float(clutter.typical_px)
    outer = ends_of(evidence.union_ends_mm)
    compared = 0
    for n in np.flatnonzero(evidence.possible):
        row = precise.true[n, VIEWS]
        members = VIEWS, row
        # Nearly along epipolar lines, the lines that fit are too many to be nearly straight.
        if sine_of(table.matrix_px[VIEWS], table.line[members]) < 0.1:
            continue
        compared += 1
        integral = log_evidence(
            table.matrix_px[VIEWS], table.ends_px[members], table.across_px2[members], ends_mm[n]
        )
        density = np.asarray(clutter.log_density)[members]
        strangers = np.sum(density - np.log(table.length_px[members]))
        # Each segment is as long as its ends lie apart on the line.
        along = ends_mm[n, 1] - ends_mm[n, 0]
        along = along / np.linalg.norm(along)
        lengths = [
            np.ptp([on_line(table, view, segment, end, ends_mm[n, 0], along) for end in (0, 1)])
            for view, segment in zip(*members, strict=True)
        ]
        lengths = np.array(lengths) * evidence.px_per_mm[n]
        one = np.log(typical) - 2 * np.log(typical + lengths)
        ends = one[lengths.argmax()] - one.sum() - 2 * np.log(lengths.max())
        expected = integral - strangers - np.log(evidence.px_per_mm[n]) + ends
        np.testing.assert_allclose(evidence.log_density[n], expected, atol=0.05)
        covered = np.linalg.norm(outer[n, 1] - outer[n, 0]) * evidence.px_per_mm[n]
        assert covered >= lengths.max() * (1 - 1e-9)
    assert compared >= 15


def sine_of(matrices_px: np.ndarray, lines_px: np.ndarray) -> float:
    normal = np.einsum("vij,vi->vj", matrices_px[:, :, :3], lines_px)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return float(np.linalg.norm(np.cross(*normal)))


def on_line(table, view: int, segment: int, end: int, origin, along) -> float:
    """Position on a line nearest to the ray of a segment's end, mm."""
    ray = np.linalg.solve(
        table.matrix_px[view, :, :3], np.append(table.ends_px[view, segment, end], 1.0)
    )
    system = np.stack([along, -ray], axis=1)
    return np.linalg.lstsq(system, table.centre_mm[view] - origin)[0][0]


def test_which_view_comes_first_means_nothing(
    precise: MadeScene, clutter: ClutterModel, evidence: PairEvidence
) -> None:
    turn = VIEWS[::-1].copy()
    swapped = jax.tree.map(
        np.asarray, evidence_of(precise.inputs.lines, turn, precise.true[:, turn], clutter)
    )
    np.testing.assert_array_equal(swapped.possible, evidence.possible)
    np.testing.assert_allclose(swapped.log_density, evidence.log_density, atol=1e-8)
    ends = ends_of(evidence.ends_mm)[:, ::-1]
    np.testing.assert_allclose(ends_of(swapped.ends_mm), ends, atol=1e-6)
    np.testing.assert_allclose(swapped.px_per_mm, evidence.px_per_mm, rtol=1e-9)
    np.testing.assert_allclose(swapped.end_log, evidence.end_log[:, ::-1], atol=1e-7)
    np.testing.assert_array_equal(swapped.expected_views, evidence.expected_views)


def test_a_pair_is_expected_where_another_picture_would_show_it(
    precise: MadeScene, evidence: PairEvidence
) -> None:
    table, points = precise.table, ends_of(evidence.ends_mm)
    image = image_px(table.matrix_px[1], points)
    inside = ((image > 0) & (image < table.size_px[1])).all(axis=(1, 2))
    np.testing.assert_array_equal(evidence.expected_views, inside.astype(float))


def test_ends_that_agree_are_likelier_than_strangers(
    exact: MadeScene, clutter: ClutterModel
) -> None:
    pairs = evidence_of(exact.inputs.lines, VIEWS, exact.true[:, VIEWS], clutter)
    end_log = np.array(pairs.end_log)
    assert end_log.shape == (30, 2, len(AGREEING_PX) + 1)
    assert (end_log[:, :, :-1].max(axis=2) > 0).mean() > 0.9
    np.testing.assert_array_equal(end_log[:, :, -1], 0)
