"""The common part of a pair: its ends correspond, and the order of the views does not matter."""

from itertools import product

import jax
import numpy as np
import pytest

from tests.match.scene import MadeScene, image_px, place_on
from trinoc.geometry import fundamental_matrix
from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.two_view.epipolar_pencil import (
    build_pencil,
    common_ends_mm,
    cut_pair,
    take_segments,
)

PAIRS = np.array(list(product(range(30), range(30))))

between_views = jax.jit(fundamental_matrix)


@jax.jit
def cut(lines: SegmentTable, a, b, pairs):
    """(ends in space, possible or not) of pairs of segments of views a and b."""
    planes = build_pencil(lines, a, b)

    def one(pair):
        rows = take_segments(planes.first, pair[0]), take_segments(planes.second, pair[1])
        part = cut_pair(planes.baseline_mm, *rows, DEFAULT.candidates)
        return common_ends_mm(planes, part), part.possible

    return jax.vmap(one)(pairs)


@pytest.fixture(scope="module")
def parts(exact: MadeScene) -> tuple[np.ndarray, np.ndarray]:
    points, possible = cut(exact.inputs.lines, np.array(0), np.array(1), PAIRS)
    return np.moveaxis(np.array(points), 2, 0), np.asarray(possible)


def test_each_cut_end_is_an_end_of_one_of_the_segments(exact: MadeScene, parts) -> None:
    points, possible = parts
    assert possible.sum() > 100
    nearest = []
    for view in (0, 1):
        image = image_px(exact.table.matrix_px[view], points)
        position = place_on(exact.table.ends_px[view, PAIRS[:, view]], image)
        nearest.append(np.minimum(np.abs(position), np.abs(position - 1)))
    np.testing.assert_allclose(np.minimum(*nearest)[possible], 0, atol=1e-9)


def test_segments_between_other_epipolar_lines_have_no_common_part(exact: MadeScene, parts) -> None:
    table = exact.table
    fundamental = np.asarray(between_views(table.matrix_px[1], table.matrix_px[0]))
    a, b = (table.ends_px[v, PAIRS[:, v]] for v in (0, 1))
    homogeneous = np.concatenate([a, np.ones((len(a), 2, 1))], axis=2)
    partner = np.cross(homogeneous @ fundamental.T, table.line[1, PAIRS[:, 1]][:, None])
    # Positions of the partners of the first segment's ends on the line of the second; those far
    # away may be beyond its infinity.
    partner_position = place_on(b, partner[..., :2] / partner[..., 2:])
    is_disjoint = (partner_position.min(axis=1) > 1) | (partner_position.max(axis=1) < 0)
    is_disjoint &= np.abs(partner_position).max(axis=1) < 5
    assert is_disjoint.sum() > 30
    assert not parts[1][is_disjoint].any()


def test_cut_ends_lie_on_both_segments_and_correspond(exact: MadeScene, parts) -> None:
    points, possible = parts
    table = exact.table
    fundamental = np.asarray(between_views(table.matrix_px[1], table.matrix_px[0]))
    images = []
    for view in (0, 1):
        image = image_px(table.matrix_px[view], points[possible])
        line, ends = table.line[view, PAIRS[possible, view]], table.ends_px[view]
        across = (image * line[:, None, :2]).sum(-1) + line[:, None, 2]
        np.testing.assert_allclose(across, 0, atol=1e-7)
        inside = place_on(ends[PAIRS[possible, view]], image)
        assert ((inside > -1e-7) & (inside < 1 + 1e-7)).all()
        images.append(np.concatenate([image, np.ones_like(image[..., :1])], axis=-1))
    epipolar = images[0] @ fundamental.T
    residual = (images[1] * epipolar).sum(-1) / np.linalg.norm(epipolar[..., :2], axis=-1)
    np.testing.assert_allclose(residual, 0, atol=1e-7)


def test_which_view_comes_first_means_nothing(exact: MadeScene, parts) -> None:
    points, possible = parts
    turned = cut(exact.inputs.lines, np.array(1), np.array(0), PAIRS[:, ::-1].copy())
    np.testing.assert_array_equal(turned[1], possible)
    turned_points = np.moveaxis(np.array(turned[0]), 2, 0)[possible]
    # The angles run the other way.
    np.testing.assert_allclose(turned_points[:, ::-1], points[possible], rtol=1e-7, atol=1e-6)


def test_partners_are_cut_to_the_whole_line(exact: MadeScene, parts) -> None:
    points, possible = parts
    partners = exact.true[:, 0] * 30 + exact.true[:, 1]
    ends = points[partners]
    swap = ((ends - exact.lines_mm) ** 2).sum((1, 2)) > 1.0
    ends = np.where(swap[:, None, None], ends[:, ::-1], ends)
    assert possible[partners].all()
    np.testing.assert_allclose(ends, exact.lines_mm, atol=1e-6)
