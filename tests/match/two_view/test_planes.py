"""Planes of sight: distances, magnifications and variances agree with elementary geometry."""

import jax
import numpy as np
import pytest

from tests.match.scene import MadeScene, image_px, place_on
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.two_view.planes import (
    InterpretationPlanes,
    extents_on_line,
    image_length_px,
    interpretation_planes,
    segment_planes,
    variance_mm2,
)
from trinoc.numerics.vectors import unit3, vector3

VIEW = 1


def sights(lines, segments):
    """Planes of sight of all segments of one view."""
    clutter = ClutterModel(np.zeros(lines.length_px.shape), np.array(30.0))
    return segment_planes(lines, clutter, np.array([VIEW]), segments[None])


@jax.jit
def planes_at(lines, segments, points_mm):
    """Planes, variances (v00, v01, v11) of the distances and image lengths of the only view."""
    points = vector3(points_mm.swapaxes(0, 1))
    sight = sights(lines, segments)
    planes = interpretation_planes(sight, points)
    pairs = ((0, 0), (0, 1), (1, 1))
    variance = [variance_mm2(sight, planes, *pair) for pair in pairs]
    return jax.tree.map(lambda x: x[0], (planes, variance, image_length_px(planes)))


@jax.jit
def extents(lines, segments, points_mm):
    along = unit3(vector3(points_mm[:, 1] - points_mm[:, 0]))
    low, high = extents_on_line(sights(lines, segments), vector3(points_mm[:, 0]), along)
    return low[0], high[0]


def plane_of_sight(matrix_px: np.ndarray, ends_px: np.ndarray) -> np.ndarray:
    """(n, 4) planes with unit normal through the centre and both ends."""
    homogeneous = np.concatenate([ends_px, np.ones_like(ends_px[..., :1])], axis=-1)
    plane = np.cross(homogeneous[:, 0], homogeneous[:, 1]) @ matrix_px
    return plane / np.linalg.norm(plane[:, :3], axis=1, keepdims=True)


def distances_mm(plane: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
    return (points_mm * plane[:, None, :3]).sum(-1) + plane[:, None, 3]


@pytest.fixture(scope="module")
def at_line_ends(exact: MadeScene) -> tuple[InterpretationPlanes, list, np.ndarray]:
    """Results at both ends of the lines, which are moved off their planes by some millimetres."""
    return jax.tree.map(
        np.asarray, planes_at(exact.inputs.lines, exact.true[:, VIEW], exact.lines_mm + 1.0)
    )


def test_normals_and_distances_are_those_of_the_plane(exact: MadeScene, at_line_ends) -> None:
    table = exact.table
    plane = plane_of_sight(table.matrix_px[VIEW], table.ends_px[VIEW, exact.true[:, VIEW]])
    normal = np.stack(at_line_ends[0].normal, axis=1)
    sign = np.sign((normal * plane[:, :3]).sum(1))
    np.testing.assert_allclose(normal, sign[:, None] * plane[:, :3], atol=1e-10)
    expected = sign[:, None] * distances_mm(plane, exact.lines_mm + 1.0)
    np.testing.assert_allclose(at_line_ends[0].distance_mm.T, expected, atol=1e-8)


def test_places_and_lengths_are_those_of_the_images(exact: MadeScene, at_line_ends) -> None:
    table = exact.table
    image = image_px(table.matrix_px[VIEW], exact.lines_mm + 1.0)
    ends = table.ends_px[VIEW, exact.true[:, VIEW]]
    np.testing.assert_allclose(at_line_ends[0].interval.T, place_on(ends, image), atol=1e-10)
    np.testing.assert_allclose(at_line_ends[2], np.linalg.norm(image[:, 1] - image[:, 0], axis=1))


def test_magnification_and_variance_are_derivatives(exact: MadeScene) -> None:
    table, step, true = exact.table, 1e-4, exact.true[:, VIEW]
    matrix, ends, line = table.matrix_px[VIEW], table.ends_px[VIEW, true], table.line[VIEW, true]
    at_line = planes_at(exact.inputs.lines, true, exact.lines_mm)
    on_plane, stated_mm2, _ = jax.tree.map(np.asarray, at_line)
    normal = np.stack(on_plane.normal, axis=1)

    def across_px(points_mm: np.ndarray) -> np.ndarray:
        return (image_px(matrix, points_mm) * line[:, None, :2]).sum(-1) + line[:, None, 2]

    moved = exact.lines_mm + step * normal[:, None]
    expected = (across_px(moved) - across_px(exact.lines_mm)) / step
    np.testing.assert_allclose(on_plane.px_per_mm.T, expected, rtol=1e-4)

    effect = []
    for end in range(2):
        turned = ends.copy()
        turned[:, end] += step * line[:, :2]
        effect.append(distances_mm(plane_of_sight(matrix, turned), exact.lines_mm) / step)
    effect = np.stack(effect, axis=2)
    variance = effect @ table.across_px2[VIEW, true] @ effect.mT
    for stated, (i, j) in zip(stated_mm2, ((0, 0), (0, 1), (1, 1)), strict=True):
        np.testing.assert_allclose(stated, variance[:, i, j], rtol=1e-3, atol=1e-9)


def test_extents_are_nearest_to_the_rays(exact: MadeScene) -> None:
    # Lines beside those that the segments show.
    lines_mm, true = exact.lines_mm + np.array([2.0, -1.0, 0.5]), exact.true[:, VIEW]
    line_extents = np.stack(extents(exact.inputs.lines, true, lines_mm), axis=1)
    table = exact.table
    along = lines_mm[:, 1] - lines_mm[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    nearest = np.zeros_like(line_extents)
    for n in range(len(true)):
        for end in range(2):
            ray = np.linalg.solve(
                table.matrix_px[VIEW, :, :3], np.append(table.ends_px[VIEW, true[n], end], 1.0)
            )
            # The least of |origin + s along - centre - t ray|.
            system = np.stack([along[n], -ray], axis=1)
            solution = np.linalg.lstsq(system, table.centre_mm[VIEW] - lines_mm[n, 0])[0]
            nearest[n, end] = solution[0]
    np.testing.assert_allclose(line_extents, np.sort(nearest, axis=1), atol=1e-7)
