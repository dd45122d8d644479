"""Laws of the removal of hidden lines."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulation import block_scene, loose_segments
from simulation.scenes import Scene, demo_scene, see_through_boxes
from simulation.solids import Cylinder, box, l_block, wedge
from trinoc.synth import table1_rig
from trinoc.synth.rigs import random_rig
from trinoc.synth.truth import points_along
from trinoc.synth.visibility import visible_parts

CAMERA = table1_rig()["left"]
TURNS = st.floats(0.0, 360.0)
SEEDS = st.integers(0, 10_000)


def is_visible(camera, point_mm, triangles_mm):
    """True if the point lies in the image and no triangle hides it."""
    alone = np.stack([point_mm, point_mm])[None]
    return len(visible_parts(camera, alone, triangles_mm).segment) > 0


def volume(solid):
    a, b, c = np.moveaxis(solid.triangles_mm, 1, 0)
    return np.einsum("ti,ti->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize(
    ("solid", "expected"),
    [
        (box((3.0, 4.0, 5.0)), 60.0),
        (wedge((3.0, 4.0, 5.0)), 30.0),
        (l_block((4.0, 5.0, 2.0), 1.0, standing=False), 2.0 * (4 + 4)),
        (l_block((4.0, 2.0, 5.0), 1.0, standing=True), 2.0 * (4 + 4)),
        (Cylinder(np.array([1.0, 2.0, 3.0]), 2.0, 5.0, 720), np.pi * 20),
    ],
)
def test_faces_look_outward_and_enclose_the_volume(solid, expected):
    assert volume(solid) == pytest.approx(expected, rel=2e-5)
    turned = solid.place(turn_deg=33.0, shift_mm=np.array([5.0, -2.0, 1.0]))
    assert volume(turned) == pytest.approx(volume(solid))
    assert turned.edges_mm[..., 2].min() == pytest.approx(solid.edges_mm[..., 2].min() + 1.0)


@pytest.mark.parametrize(
    ("solid", "edges"),
    [
        (box((3.0, 4.0, 5.0)), 12),
        (wedge((3.0, 4.0, 5.0)), 9),
        (l_block((4.0, 5.0, 2.0), 1.0, standing=True), 18),
    ],
)
def test_polyhedra_obey_euler(solid, edges):
    assert len(solid.edges_mm) == edges
    assert len(solid.vertices_mm) - edges + len(solid.faces) == 2


@given(turn=TURNS)
def test_of_a_box_the_edges_of_faces_turned_to_the_camera_are_seen_whole(turn):
    solid = box((30.0, 40.0, 20.0)).place(turn_deg=turn, shift_mm=np.zeros(3))
    centre = CAMERA.centre_world_mm
    facing = []
    for face, triangles in zip(solid.faces, solid.face_triangles_mm, strict=True):
        a, b, c = triangles[0]
        side = np.cross(b - a, c - a) @ (centre - a)
        # Seen edge-on a face is neither; rounding decides.
        if abs(side) < 1e-3 * np.linalg.norm(np.cross(b - a, c - a)):
            return
        if side > 0:
            facing.append(set(face))
    scene = Scene.of_solids((solid,))
    corners = solid.vertices_mm
    parts = scene.seen_by(CAMERA)
    for index, ends in enumerate(scene.edges_mm):
        pair = {int(np.argmin(np.linalg.norm(corners - end, axis=1))) for end in ends}
        extents = parts.extent[parts.segment == index]
        if any(pair <= face for face in facing):
            np.testing.assert_allclose(extents, [[0.0, 1.0]], atol=1e-9)
        else:
            assert len(extents) == 0


def test_a_face_hides_what_lies_behind_it_and_nothing_else():
    square = np.array([[-20.0, -20, 30], [20, -20, 30], [20, 20, 30], [-20, 20, 30]])
    triangles = np.stack([square[[0, 1, 2]], square[[0, 2, 3]]])
    centre = CAMERA.centre_world_mm
    for target, hidden in (((0.0, 0.0, 30.0), True), ((60.0, 0.0, 30.0), False)):
        ray = np.array(target) - centre
        assert is_visible(CAMERA, centre + 0.9 * ray, triangles)
        assert is_visible(CAMERA, centre + 1.1 * ray, triangles) is not hidden


def test_the_border_of_what_is_hidden_is_exact():
    triangle = np.array([[[-30.0, -30.0, 20.0], [30.0, -30.0, 20.0], [0.0, 40.0, 20.0]]])
    segment = np.array([[[-70.0, 0.0, 0.0], [70.0, 5.0, 0.0]]])
    parts = visible_parts(CAMERA, segment, triangle)
    assert len(parts.segment) == 2
    centre = CAMERA.centre_world_mm
    for position, side in ((parts.extent[0, 1], (0, 2)), (parts.extent[1, 0], (1, 2))):
        point = points_along(segment, np.array([[position]]))[0, 0]
        a, b = triangle[0][list(side)]
        # The ray to a border point meets a side of the triangle.
        assert np.cross(a - centre, b - centre) @ (point - centre) == pytest.approx(0.0, abs=1e-3)


@given(seed=SEEDS)
def test_the_order_of_faces_and_the_direction_of_edges_do_not_matter(seed):
    scene = block_scene(seed, count=4, cylinder_sides=8)
    generator = np.random.default_rng(seed)
    shuffled = generator.permutation(scene.triangles_mm)[:, generator.permutation(3)]
    parts = scene.seen_by(CAMERA)
    other = visible_parts(CAMERA, scene.edges_mm[:, ::-1], shuffled)
    np.testing.assert_array_equal(parts.segment, other.segment)
    for index in np.unique(parts.segment):
        turned = 1 - other.extent[other.segment == index][::-1, ::-1]
        np.testing.assert_allclose(parts.extent[parts.segment == index], turned, atol=1e-6)


@given(seed=SEEDS)
def test_samples_agree_with_rays(seed):
    scene, camera = block_scene(seed, count=4, cylinder_sides=8), random_rig(seed)["upper"]
    parts = scene.seen_by(camera)
    generator = np.random.default_rng(seed)
    for index in generator.integers(len(scene.edges_mm), size=6):
        position = generator.uniform(0.0, 1.0)
        extents = parts.extent[parts.segment == index]
        if len(extents) and np.abs(extents - position).min() < 1e-3:
            continue
        point = points_along(scene.edges_mm[[index]], np.array([[position]]))[0, 0]
        is_shown = bool(np.any((extents[:, 0] < position) & (position < extents[:, 1])))
        assert is_shown == _ray_is_free(camera, point, scene.triangles_mm)


def _ray_is_free(camera, point, triangles):
    """True if the point is visible, by the ray-triangle intersection of Moeller and Trumbore."""
    u, v, w = camera.matrix_px @ np.append(point, 1.0)
    if not (-0.5 < u / w < 511.5 and -0.5 < v / w < 479.5):
        return False
    centre = camera.centre_world_mm
    ray = point - centre
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(ray, second)
    determinant = np.einsum("ti,ti->t", first, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = centre - triangles[:, 0]
        a = np.einsum("ti,ti->t", offset, normal) / determinant
        across = np.cross(offset, first)
        b = across @ ray / determinant
        t = np.einsum("ti,ti->t", second, across) / determinant
    hit = (a >= 0) & (b >= 0) & (a + b <= 1) & (t > 0) & (t < 1 - 1e-6)
    return not np.any(hit)


def test_what_leaves_the_picture_or_lies_behind_the_camera_is_not_seen():
    none = np.zeros((0, 3, 3))
    centre = CAMERA.centre_world_mm
    line_mm = np.array([[[0.0, 0.0, 0.0], [5000.0, 0.0, 0.0]]])
    parts = visible_parts(CAMERA, line_mm, none)
    end = points_along(line_mm, parts.extent[:, 1:])[0, 0]
    u, _, w = CAMERA.matrix_px @ np.append(end, 1.0)
    assert u / w == pytest.approx(511.5)
    assert not is_visible(CAMERA, 2 * centre, none)


def test_a_silhouette_is_tangent_and_no_edge():
    cylinder = Cylinder(np.array([20.0, -10.0, 0.0]), 15.0, 30.0)
    centre = CAMERA.centre_world_mm
    lines = cylinder.silhouette_mm(centre)
    assert len(lines) == 2
    for foot, top in lines:
        radius = foot[:2] - cylinder.base_centre_mm[:2]
        assert np.hypot(*radius) == pytest.approx(15.0)
        assert radius @ (centre[:2] - foot[:2]) == pytest.approx(0.0, abs=1e-9)
        assert top[2] - foot[2] == 30.0
    scene = Scene.of_solids((cylinder,))
    silhouettes = scene.silhouettes_seen_by(CAMERA)
    np.testing.assert_allclose(silhouettes, lines, atol=1e-6)


def test_scenes_repeat_by_seed_and_their_solids_stand_apart():
    for seed in range(8):
        scene, same_seed = block_scene(seed), block_scene(seed)
        np.testing.assert_array_equal(scene.edges_mm, same_seed.edges_mm)
        assert {s.kind for s in scene.solids} >= {"box", "wedge", "l_block", "cylinder"}
        assert scene.edges_mm[..., 2].min() == pytest.approx(0.0, abs=1e-9)
    assert len(demo_scene().solids) == 6
    for make in (loose_segments, see_through_boxes):
        loose = make(1, count=10)
        parts = loose.seen_by(CAMERA)
        np.testing.assert_array_equal(parts.segment, np.unique(parts.segment))
