"""The pencil: partners share planes, slopes give depth, and the world's frame does not matter."""

from typing import Any

import jax
import numpy as np
import pytest

from tests.match.scene import MadeScene
from trinoc.geometry.rig import Rig
from trinoc.geometry.rotation import rotation_from_vector
from trinoc.match.observations.match_input import prepare
from trinoc.match.two_view.epipolar_pencil import (
    Pencil,
    PencilSegments,
    build_pencil,
    end_angles,
    plane_angles,
)

FIRST, SECOND = np.array(0), np.array(1)


@pytest.fixture(scope="module")
def planes(exact: MadeScene) -> Pencil:
    return build_pencil(exact.inputs.lines, FIRST, SECOND)


def rows(segments: PencilSegments, index: np.ndarray) -> Any:
    """Rows of PencilSegments as NumPy arrays."""
    return jax.tree.map(lambda column: np.asarray(column)[..., index], segments)


def slopes(segments: PencilSegments, angle: np.ndarray) -> np.ndarray:
    p, q = np.asarray(segments.p), np.asarray(segments.q)
    return p * np.cos(angle) + q * np.sin(angle)


def test_partners_end_at_the_planes_of_the_ends_in_space(exact: MadeScene, planes: Pencil) -> None:
    a, b = rows(planes.first, exact.true[:, 0]), rows(planes.second, exact.true[:, 1])
    in_frame = (exact.lines_mm - np.asarray(planes.origin_mm)) @ np.asarray(planes.frame).T
    angle = np.sort(np.arctan2(in_frame[..., 2], in_frame[..., 1]), axis=1)
    for segments in (a, b):
        np.testing.assert_allclose(segments.low, angle[:, 0], atol=1e-10)
        np.testing.assert_allclose(segments.high, angle[:, 1], atol=1e-10)


def test_slopes_differ_by_baseline_over_radius(exact: MadeScene, planes: Pencil) -> None:
    a, b = rows(planes.first, exact.true[:, 0]), rows(planes.second, exact.true[:, 1])
    centres = exact.table.centre_mm
    axis = (centres[1] - centres[0]) / np.linalg.norm(centres[1] - centres[0])
    np.testing.assert_allclose(planes.baseline_mm, np.linalg.norm(centres[1] - centres[0]))
    for share in (0.0, 0.3, 1.0):
        point = (1 - share) * exact.lines_mm[:, 0] + share * exact.lines_mm[:, 1]
        radius = np.linalg.norm(np.cross(point - centres[0], axis), axis=1)
        in_frame = (point - centres[0]) @ np.asarray(planes.frame).T
        angle = np.arctan2(in_frame[:, 2], in_frame[:, 1])
        np.testing.assert_allclose(slopes(a, angle), in_frame[:, 0] / radius, atol=1e-9)
        difference = slopes(a, angle) - slopes(b, angle)
        np.testing.assert_allclose(difference, np.asarray(planes.baseline_mm) / radius, rtol=1e-8)


def test_variances_are_those_of_moved_ends(exact: MadeScene, planes: Pencil) -> None:
    step, true = 1e-4, exact.true[:, 0]
    lines, a = exact.table, rows(planes.first, true)
    normal = lines.line[..., :2]
    along = np.stack([normal[..., 1], -normal[..., 0]], axis=-1)

    def with_end(end: int, direction: np.ndarray) -> Any:
        ends = lines.ends_px.copy()
        ends[:, :, end] += step * direction
        return rows(
            build_pencil(exact.inputs.lines._replace(ends_px=ends), FIRST, SECOND).first, true
        )

    # The ends by plane angle: `low` is that of the first end, or of the second.
    moved = [with_end(end, along) for end in (0, 1)]
    low_is_first = np.abs(moved[0].low - a.low) > np.abs(moved[0].high - a.high)
    effect = np.zeros((2, 2, len(true)))
    slide = np.zeros((2, len(true)))
    for end, across in enumerate([with_end(0, normal), with_end(1, normal)]):
        for row, angle in enumerate((a.low, a.high)):
            effect[row, end] = (slopes(across, angle) - slopes(a, angle)) / step
        first = low_is_first if end == 0 else ~low_is_first
        turn = [np.where(first, m.low - a.low, m.high - a.high) for m in (across, moved[end])]
        slide[0, first], slide[1, ~first] = (
            ((turn[0] / turn[1]) ** 2)[first],
            ((turn[0] / turn[1]) ** 2)[~first],
        )
    covariance = lines.across_px2[0, true]
    expected = np.einsum("pen,nef,qfn->npq", effect, covariance, effect)
    for stated, (i, j) in zip(a.slope_variance, ((0, 0), (0, 1), (1, 1)), strict=True):
        # Differences over 1e-4 px are good to some 1e-12.
        np.testing.assert_allclose(stated, expected[:, i, j], rtol=1e-3, atol=1e-11)
    for row, stated in enumerate(a.end_variance_px2):
        np.testing.assert_allclose(stated, slide[row] * covariance[:, 0, 0], rtol=1e-2)


def test_a_rigid_motion_of_the_world_changes_nothing(exact: MadeScene, planes: Pencil) -> None:
    turn = np.asarray(rotation_from_vector(np.array([0.4, -1.1, 0.7])))
    to_old = np.eye(4)
    to_old[:3, :3], to_old[:3, 3] = turn.T, -turn.T @ np.array([300.0, -50.0, 120.0])
    matrices = dict(zip(exact.rig.names, exact.rig.matrices_px @ to_old, strict=True))
    moved = prepare(exact.pictures_px, Rig.from_matrices(matrices, (512, 480)), 0.3)
    assert moved.names == exact.inputs.names
    moved_pencil = build_pencil(moved.lines, FIRST, SECOND)
    np.testing.assert_allclose(moved_pencil.frame, np.asarray(planes.frame) @ turn.T, atol=1e-12)
    for old, new in ((planes.first, moved_pencil.first), (planes.second, moved_pencil.second)):
        for column, other in zip(old, new, strict=True):
            np.testing.assert_allclose(
                np.asarray(column)[..., :30], np.asarray(other)[..., :30], rtol=1e-7, atol=1e-9
            )


def test_ranges_about_ends_hold_partners_and_reach_as_far_as_asked(
    noisy: MadeScene, exact: MadeScene
) -> None:
    def ranges(scene: MadeScene, reach_px: float) -> list[np.ndarray]:
        lines, both = scene.inputs.lines, build_pencil(scene.inputs.lines, FIRST, SECOND)
        ranges_by_view = []
        for view, segments in enumerate((both.first, both.second)):
            angles = plane_angles(lines, view, segments)
            ranges_by_view.append(
                end_angles(lines, view, segments, angles, reach_px)[scene.true[:, view]]
            )
        return ranges_by_view

    def meet(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return (one[..., 0] < other[..., 1]) & (other[..., 0] < one[..., 1])

    assert meet(*ranges(exact, 0.1)).all()
    assert meet(*ranges(noisy, 2.0)).mean() > 0.95
    # As a share of the segment, the reach is what it is as a share of its length.
    lines, at_ends, extended = exact.table, ranges(exact, 0.0)[0], ranges(exact, 5.0)[0]
    span = np.diff(at_ends.mean(axis=2), axis=1)
    share = 5.0 / np.asarray(lines.length_px)[0, exact.true[:, 0], None]
    np.testing.assert_allclose(
        (extended - at_ends)[..., 1] / span, np.broadcast_to(share, (*span.shape[:1], 2))
    )
