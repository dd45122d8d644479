import jax
import numpy as np
from hypothesis import given

from tests.geometry import trifocal
from tests.geometry.strategies import points_near_sheet, real, rigs_of_three, vectors
from trinoc.geometry import camera as camera_module, epipolar, line_through
from trinoc.geometry.lines import signed_distance

centre_of_matrix = jax.jit(epipolar.centre_of_matrix)
epipolar_distance_px = jax.jit(epipolar.epipolar_distance_px)
epipole = jax.jit(epipolar.epipole)
fundamental_matrix = jax.jit(epipolar.fundamental_matrix)
inverse_3x3 = jax.jit(epipolar.inverse_3x3)
project = jax.jit(camera_module.project)
transfer_line = jax.jit(trifocal.transfer_line)
trifocal_tensor = jax.jit(trifocal.trifocal_tensor)


def unit(matrix):
    return np.asarray(matrix) / np.linalg.norm(matrix)


@given(rigs_of_three())
def test_centre_and_inverse_by_cofactors(rig):
    for camera in rig:
        np.testing.assert_allclose(
            centre_of_matrix(camera.matrix_px), camera.centre_world_mm, atol=1e-6
        )
        left_3x3 = camera.matrix_px[:, :3]
        np.testing.assert_allclose(inverse_3x3(left_3x3) @ left_3x3, np.eye(3), atol=1e-9)


@given(rigs_of_three(), points_near_sheet())
def test_partners_satisfy_the_epipolar_constraint(rig, point):
    a, b, _ = rig
    fundamental = fundamental_matrix(b.matrix_px, a.matrix_px)
    distance = epipolar_distance_px(fundamental, project(b, point), project(a, point))
    assert abs(distance) < 1e-7


@given(rigs_of_three())
def test_the_fundamental_matrix_transposes_and_annihilates_the_epipoles(rig):
    a, b, _ = rig
    ba = unit(fundamental_matrix(b.matrix_px, a.matrix_px))
    ab = unit(fundamental_matrix(a.matrix_px, b.matrix_px))
    assert min(abs(ba - ab.T).max(), abs(ba + ab.T).max()) < 1e-9
    in_a, in_b = epipole(a.matrix_px, b.matrix_px), epipole(b.matrix_px, a.matrix_px)
    np.testing.assert_allclose(ba @ unit(in_a), 0, atol=1e-9)
    np.testing.assert_allclose(ba.T @ unit(in_b), 0, atol=1e-9)
    assert abs(np.linalg.det(ba)) < 1e-12


@given(rigs_of_three(), points_near_sheet(), vectors(3, 1.0), real(5, 60))
def test_two_views_of_a_line_predict_the_third(rig, point, direction, length):
    other = point + length * direction / max(np.linalg.norm(direction), 1e-3)
    if np.linalg.norm(other - point) < 1:
        return
    lines = []
    for camera in rig:
        lines.append(line_through(project(camera, point), project(camera, other)))
    predicted = transfer_line(trifocal_tensor(*(c.matrix_px for c in rig)), lines[1], lines[2])
    centres = [camera.centre_world_mm for camera in rig]
    plane = np.cross(point - centres[1], other - centres[1])
    second = np.cross(point - centres[2], other - centres[2])
    angle = np.linalg.norm(np.cross(unit(plane), unit(second)))
    if (
        angle < 0.02
        or np.linalg.norm(np.diff([project(rig[0], p) for p in (point, other)], axis=0)) < 2
    ):
        return  # the line lies in an epipolar plane of the two views, or is seen end on
    for end in (point, other):
        assert abs(signed_distance(predicted, project(rig[0], end))) < 1e-5


@given(rigs_of_three())
def test_the_trifocal_tensor_changes_sign_order_with_its_views(rig):
    """Swapping views b and c exchanges the last two axes, up to the sign of the determinant."""
    a, b, c = (camera.matrix_px for camera in rig)
    abc, acb = unit(trifocal_tensor(a, b, c)), unit(trifocal_tensor(a, c, b))
    np.testing.assert_allclose(abc, -np.swapaxes(acb, 1, 2), atol=1e-9)


@given(vectors(2, 100.0), vectors(2, 100.0), vectors(2, 100.0))
def test_distance_from_a_line_and_its_side(first, second, point):
    if np.linalg.norm(second - first) < 1:
        return
    line = line_through(first, second)
    assert abs(signed_distance(line, first)) < 1e-9
    assert abs(signed_distance(line, second)) < 1e-9
    foot = point - signed_distance(line, point) * np.asarray(line[:2])
    assert abs(signed_distance(line, foot)) < 1e-9
    np.testing.assert_allclose(trifocal.normalised_line(3 * np.asarray(line)), line, atol=1e-12)


def test_the_right_of_a_line_is_right_on_the_picture():
    """The right side of a line along +u is below it because v points down."""
    line = line_through(np.array([0.0, 0.0]), np.array([10.0, 0.0]))
    assert signed_distance(line, np.array([5.0, 3.0])) > 0


def test_epipolar_geometry_is_differentiable():
    from tests.geometry.strategies import LENS
    from trinoc.geometry.camera import Camera

    a = Camera.from_degrees(LENS, pan_deg=0, tilt_deg=50, swing_deg=0, distance_mm=470)
    b = Camera.from_degrees(LENS, pan_deg=25, tilt_deg=40, swing_deg=0, distance_mm=470)
    gradient = jax.grad(
        lambda uv: epipolar_distance_px(
            fundamental_matrix(b.matrix_px, a.matrix_px), uv, np.array([200.0, 210.0])
        )
    )(np.array([220.0, 190.0]))
    np.testing.assert_allclose(np.linalg.norm(gradient), 1.0, atol=1e-12)
