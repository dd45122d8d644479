"""Laws of cameras without distortion: rows and depths of rectified pairs, the field of view,
the refusals and the covariance."""

import itertools
from typing import Any

import cv2
import equinox as eqx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.geometry.strategies import (
    DISTORTED_LENS,
    LENS,
    cameras,
    points_near_sheet,
    rigs_of_three,
)
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.ideal_cameras import undistort_lens, undistort_rig
from trinoc.geometry.intrinsics import Intrinsics, distort_pixels, undistort_pixels
from trinoc.geometry.picture_window import border_in_plane, fit_windows
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_points
from trinoc.geometry.rectification import rectify_pair, share_of_common_field
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.geometry.rotation import rotation_from_vector
from trinoc.image.ideal_pictures import rectify, undistort
from trinoc.synth.rigs import table1_rig

# Its stubs know no arrays of JAX.
OPENCV: Any = cv2
FISHEYE = Intrinsics(
    image_size_px=(640, 480),
    focal_length_px=(230.0, 232.0),
    distortion=(0.03, -0.01, 0.002, -0.0005),
    distortion_model="kannala_brandt",
)
SKEWED = Intrinsics(
    image_size_px=(640, 480),
    focal_length_px=(700.0, 650.0),
    skew_px=20.0,
    principal_point_px=(300.0, 260.0),
    distortion=(-0.25, 0.08, 0.002, -0.001, 0.0),
)
LENSES = {"brown": DISTORTED_LENS, "fisheye": FISHEYE, "skewed": SKEWED}


def border(lens: Intrinsics) -> np.ndarray:
    """Centres of the outermost pixels."""
    width, height = lens.image_size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    edge = (u % (width - 1) == 0) | (v % (height - 1) == 0)
    return np.stack([u[edge], v[edge]], axis=1).astype(float)


def seen_through(lens: Intrinsics, ideal: Intrinsics, turn: np.ndarray) -> np.ndarray:
    """Positions of the border of an ideal picture in the picture of a lens, px."""
    rays = np.c_[border(ideal), np.ones(len(border(ideal)))] @ np.linalg.inv(ideal.matrix).T
    return project_points(Pose(np.eye(3, 4)), lens.lens, rays @ turn)


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    return project_points(camera.pose, camera.intrinsics.lens, points)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_the_field_is_all_or_what_is_valid(lens):
    size = np.array(lens.image_size_px)
    valid, full_field = (undistort_lens(lens, alpha=alpha) for alpha in (0.0, 1.0))
    assert not valid.has_distortion
    assert valid.image_size_px == lens.image_size_px
    uv_px = seen_through(lens, valid, np.eye(3))
    assert (uv_px > -1e-2).all()
    assert (uv_px < size - 1 + 1e-2).all()
    # It touches the border: no larger one fits there.
    assert min(uv_px.min(), (size - 1 - uv_px).min()) < 0.2
    normalised = undistort_pixels(lens, border(lens))
    ideal_points = (normalised - lens.matrix[:2, 2]) @ np.linalg.inv(lens.matrix[:2, :2]).T
    within = np.linalg.norm(ideal_points, axis=1) < np.tan(np.radians(75))
    shown = (np.c_[ideal_points, np.ones(len(ideal_points))] @ full_field.matrix.T)[within, :2]
    assert (shown > -0.05).all()
    assert (shown < size - 1 + 0.05).all()
    assert full_field.focal_length_px[0] < valid.focal_length_px[0]
    for ideal in (valid, full_field):
        shape = ideal.matrix[:2, :2] / ideal.matrix[0, 0]
        np.testing.assert_allclose(shape, lens.matrix[:2, :2] / lens.matrix[0, 0], rtol=1e-12)


def test_between_valid_and_all_the_scale_is_between():
    focal = [undistort_lens(SKEWED, alpha=alpha).focal_length_px[0] for alpha in (0, 0.25, 1)]
    assert focal[1] == pytest.approx(0.75 * focal[0] + 0.25 * focal[2])
    with pytest.raises(InputError, match="alpha is 2"):
        undistort_lens(SKEWED, alpha=2.0)


def test_the_field_is_that_of_opencv():
    """OpenCV's outer field lets the shape of the pixels change, ours does not."""
    matrix, distortion = SKEWED.matrix * [[1, 0, 1], [1, 1, 1], [1, 1, 1]], SKEWED.distortion
    lens = Intrinsics(
        image_size_px=SKEWED.image_size_px,
        focal_length_px=SKEWED.focal_length_px,
        principal_point_px=SKEWED.principal_point_px,
        distortion=distortion,
    )
    theirs, _ = OPENCV.getOptimalNewCameraMatrix(matrix, distortion, lens.image_size_px, 1.0)
    ours = undistort_lens(lens, alpha=1.0)
    assert ours.focal_length_px.min() == pytest.approx(np.diag(theirs)[:2].min(), rel=0.02)
    assert (ours.focal_length_px <= np.diag(theirs)[:2] * 1.002).all()


def test_an_ideal_lens_stays_as_it_is():
    assert eqx.tree_equal(undistort_lens(LENS), LENS)
    wider = undistort_lens(LENS, image_size_px=(1024, 960))
    np.testing.assert_allclose(wider.focal_length_px, LENS.focal_length_px * 959 / 479, rtol=2e-3)


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_beyond_a_fold_in_the_corners_ideal_pictures_are_black(alpha):
    """With alpha 0 every pixel is valid; with alpha 1 pixels beyond the fold are black."""
    lens = Intrinsics(
        image_size_px=(640, 480), focal_length_px=500.0, distortion=(-0.3, 0.0, 0.001, 0.0)
    )
    ideal, maps = undistort(lens, alpha=alpha)
    u, v = np.asarray(maps.map_x, float), np.asarray(maps.map_y, float)
    away_px = np.hypot(u - lens.principal_point_px[0], v - lens.principal_point_px[1])
    assert (away_px[maps.valid] < lens.valid_radius_px + 1e-3).all()
    assert maps.valid.all() == (alpha == 0.0)
    pixels = np.stack(np.meshgrid(np.arange(640.0), np.arange(480.0)), axis=-1)
    rays = (pixels - ideal.principal_point_px) / ideal.focal_length_px
    beyond = np.arctan(np.hypot(rays[..., 0], rays[..., 1])) > lens.lens.fold_angle_rad()
    assert beyond.any() == (alpha == 1.0)
    assert not maps.valid[beyond].any()
    white = np.full((480, 640), 255, dtype=np.uint8)
    assert not maps.resample(white)[beyond].any()
    # The picture reaches to the radius, on the side where that is nearest.
    reach = away_px[maps.valid].max() / lens.valid_radius_px
    assert reach > (0.99 if alpha == 1.0 else 0.8)


def test_a_distortion_that_folds_is_refused():
    folds = Intrinsics(image_size_px=(640, 480), focal_length_px=300.0, distortion=(-0.8,))
    with pytest.raises(InputError, match="folds the image"):
        undistort_lens(folds)
    with pytest.raises(InputError, match='Camera "a": The distortion'):
        undistort_rig(Rig({"a": Camera(folds, Pose(np.eye(3, 4)))}))


def test_a_square_in_a_turned_square_is_half_as_large():
    """The largest square in a diamond has half its width, wherever the grids begin."""
    diamond = np.array([[13.0, -2.0], [3.0, 8.0], [-7.0, -2.0], [3.0, -12.0]])
    lower_diamond = diamond + np.array([0.0, 30.0])
    windows = fit_windows([diamond], (101, 101), 0.0)
    assert windows is not None
    assert 50 / windows.scale_px == pytest.approx(5.0, rel=1e-3)
    np.testing.assert_allclose((50 - windows.origins_px[0]) / windows.scale_px, [3, -2], atol=1e-2)
    assert fit_windows([diamond, lower_diamond], (101, 101), 0.0) is None
    aside = fit_windows([diamond, diamond + np.array([30.0, 0.0])], (101, 101), 0.0)
    assert aside is not None
    np.testing.assert_allclose(np.diff(aside.origins_px[:, 0]), -30 * aside.scale_px, rtol=1e-2)


POINTS = np.random.default_rng(5).uniform(-60, 60, (40, 3))


def pairs() -> st.SearchStrategy[Rig]:
    def choose(cameras: list[Camera], lens: Intrinsics) -> Rig:
        first, second = (Camera(lens, camera.pose) for camera in cameras[:2])
        return Rig({"a": first, "b": second})

    lenses = st.sampled_from([LENS, DISTORTED_LENS])
    every = st.builds(choose, rigs_of_three().flatmap(st.permutations), lenses)
    return every.filter(are_beside_each_other)


def are_beside_each_other(rig: Rig) -> bool:
    """True if both cameras look at least 40 degrees away from their baseline."""
    first, second = rig.cameras
    line = np.asarray(second.centre_world_mm) - np.asarray(first.centre_world_mm)
    along = [abs(camera.pose.rotation[2] @ line) for camera in rig.cameras]
    return max(along) < np.cos(np.radians(40.0)) * np.linalg.norm(line)


@given(rig=pairs(), alpha=st.sampled_from([0.0, 0.3, 1.0]))
@settings(max_examples=8)
def test_two_cameras_have_equal_rows_and_disparity_is_depth(rig, alpha):
    rectified, disparity = rectify_pair(rig, alpha=alpha)
    a, b = rectified.cameras
    uv_a, uv_b = project(a, POINTS), project(b, POINTS)
    np.testing.assert_allclose(uv_a[:, 1], uv_b[:, 1], atol=1e-9)
    np.testing.assert_array_equal(a.pose.rotation, b.pose.rotation)
    depth = POINTS @ a.pose.rotation[2] + a.pose.translation_mm[2]
    np.testing.assert_allclose(disparity.depth_mm(uv_a[:, 0] - uv_b[:, 0]), depth, rtol=1e-9)
    for camera, before in zip(rectified.cameras, rig.cameras, strict=True):
        np.testing.assert_allclose(camera.centre_world_mm, before.centre_world_mm, atol=1e-9)
        # The right side stays right, and up stays up.
        turn = camera.pose.rotation @ before.pose.rotation.T
        assert turn[2, 2] > 0.5
        if alpha == 0:
            uv_px = seen_through(before.intrinsics, camera.intrinsics, turn)
            assert (uv_px > -0.05).all()
            assert (uv_px < np.array(before.image_size_px) - 1 + 0.05).all()


def test_a_homography_leads_from_each_picture_to_its_rectified_one():
    """The homography maps projections into the old picture to projections into the new one."""
    three_cameras = table1_rig()
    rig = Rig({name: three_cameras[name] for name in ("left", "right")})
    rectified, _ = rectify_pair(rig)
    for name, camera in rig.items():
        new = rectified[name]
        map_ = new.intrinsics.matrix @ new.pose.rotation @ camera.pose.rotation.T
        map_ = map_ @ np.linalg.inv(camera.intrinsics.matrix)
        image = np.c_[project(camera, POINTS), np.ones(len(POINTS))] @ map_.T
        np.testing.assert_allclose(image[:, :2] / image[:, 2:], project(new, POINTS), atol=1e-9)


def test_two_cameras_turn_as_those_of_stereo_rectify():
    """OpenCV halves the turn, too; the pictures' sign and position may differ."""
    first_camera = Camera(LENS, Pose(np.eye(3, 4)))
    turn = np.asarray(rotation_from_vector(np.array([0.02, -0.1, 0.03])))
    second_camera = Camera(LENS, Pose.from_centre(turn, np.array([80.0, 4.0, -6.0])))
    rotation = rectify_pair(Rig({"a": first_camera, "b": second_camera}))[0]["a"].pose.rotation
    none = np.zeros(5)
    expected, *_ = OPENCV.stereoRectify(
        *(LENS.matrix, none) * 2,
        LENS.image_size_px,
        turn,
        second_camera.pose.translation_mm[:, None],
    )
    np.testing.assert_allclose(rotation, expected, atol=2e-3)


def convergent(angle_deg: float) -> Rig:
    """Two cameras that look at the origin, with this angle between their directions."""
    matrix = np.array([[1000, 0, 639.5], [0, 1000, 479.5], [0, 0, 1.0]])
    matrices = {}
    for name, side in (("a", -1), ("b", 1)):
        turn = side * np.radians(angle_deg) / 2
        centre = 500 * np.array([np.sin(turn), -np.cos(turn), 0.0])
        forward = -centre / 500
        right = np.cross(forward, [0.0, 0.0, 1.0])
        rotation = np.stack([right, np.cross(forward, right), forward])
        matrices[name] = matrix @ np.c_[rotation, -rotation @ centre]
    return Rig.from_matrices(matrices, (1280, 960))


@pytest.mark.parametrize("angle_deg", [0.5, 20.0, 40.0, 60.0, 75.0, 90.0])
@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_what_is_lost_of_the_common_field_is_said_or_refused(angle_deg, alpha):
    """The lost share is counted with points of a plane between both cameras and their matrices."""
    rig = convergent(angle_deg)
    x, z = np.meshgrid(np.linspace(-700, 700, 141), np.linspace(-500, 500, 101))
    points = np.stack([x.ravel(), 0 * x.ravel(), z.ravel(), np.ones(x.size)], axis=1)

    def are_shown(matrices: np.ndarray) -> np.ndarray:
        image = points @ np.swapaxes(matrices, 1, 2)
        uv = image[..., :2] / image[..., 2:]
        inside = (uv > -0.5) & (uv < [1279.5, 959.5]) & (image[..., 2:] > 0)
        return np.asarray(inside.all(axis=(0, 2)))

    common = are_shown(rig.matrices_px)
    if alpha == 0.0 and angle_deg > 70:
        with pytest.raises(InputError, match=r"would show \d % of the common field") as caught:
            rectify(rig, alpha=alpha)
        assert "Give alpha 1" in str(caught.value)
        return
    ideal = rectify(rig, alpha=alpha)
    expected = are_shown(ideal.rig.matrices_px)[common].mean()
    share = share_of_common_field(rig, dict(ideal.rig.items()))
    assert share == pytest.approx(expected, abs=0.08)
    assert len(ideal.notes) == (share < 0.75)
    assert all(f"show {100 * share:.0f} % of the common field" in note for note in ideal.notes)


def in_a_row(*x_mm: float, turn=(0.0, 0.0, 0.0)) -> Rig:
    rotation = np.asarray(rotation_from_vector(np.array(turn)))
    centres = [np.array([x, 0.0, 0.0]) for x in x_mm]
    return Rig(
        {f"c{k}": Camera(LENS, Pose.from_centre(rotation, c)) for k, c in enumerate(centres)}
    )


FRONT = POINTS + np.array([60.0, 0.0, 600.0])


@pytest.mark.parametrize(
    ("rig", "message"),
    [
        (in_a_row(0.0), "but the rig has 1"),
        (in_a_row(0.0, 1.0, 2.0), "but the rig has 3"),
        (in_a_row(10.0, 10.0), "have the same centre"),
        (in_a_row(0.0, 80.0, turn=(0.0, np.pi / 2, 0.0)), "look along their baseline"),
        (in_a_row(0.0, 80.0, turn=(0.0, 1.2, 0.0)), "it looks along the baseline to"),
    ],
)
def test_what_cannot_be_rectified_has_a_cause_and_a_remedy(rig, message):
    with pytest.raises(InputError, match=message) as caught:
        rectify_pair(rig)
    assert str(caught.value).count(". ") == 1


def test_cameras_that_look_at_opposite_sides_are_refused():
    for angle in (np.pi, 2.6):
        away = np.asarray(rotation_from_vector(np.array([0.0, angle, 0.0])))
        back = Camera(LENS, Pose.from_centre(away, np.array([80.0, 0.0, 0.0])))
        with pytest.raises(InputError, match="opposite"):
            rectify_pair(Rig({"a": Camera(LENS, Pose(np.eye(3, 4))), "b": back}))


def test_cameras_that_see_no_common_rows_are_refused():
    up, down = (np.asarray(rotation_from_vector(np.array([x, 0.0, 0.0]))) for x in (0.5, -0.5))
    second = Camera(LENS, Pose.from_centre(down, np.array([80.0, 0.0, 0.0])))
    with pytest.raises(InputError, match="no common rows"):
        rectify_pair(
            Rig(
                {
                    "a": Camera(LENS, Pose.from_centre(up, np.zeros(3))),
                    "b": second,
                }
            )
        )


def test_a_camera_that_sees_the_other_is_refused():
    wide = Intrinsics(focal_length_px=200.0, image_size_px=(640, 480))
    turn = np.asarray(rotation_from_vector(np.array([0.0, 0.9, 0.0])))
    rig = Rig(
        {
            "a": Camera(wide, Pose.from_centre(turn, np.zeros(3))),
            "b": Camera(wide, Pose.from_centre(turn, np.array([-80.0, 0.0, 0.0]))),
        }
    )
    with pytest.raises(InputError, match="where all rows would meet"):
        rectify_pair(rig)
    # A fisheye shows the other one beyond what any ideal picture shows.
    eyes = {name: Camera(FISHEYE, camera.pose) for name, camera in in_a_row(0.0, 80.0).items()}
    rectified, _ = rectify_pair(Rig(eyes))
    rows = [project(camera, FRONT)[:, 1] for camera in rectified.cameras]
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-9)


NAMES = tuple(f"{view}.{name}" for view in ("a", "b") for name in PARAMETER_NAMES[:4])


def uncertain(rig: Rig, names=NAMES) -> Rig:
    factor = np.random.default_rng(7).normal(size=(len(names), len(names))) * 1e-3
    return Rig(dict(rig.items()), parameters=names, covariance=factor @ factor.T)


def test_the_covariance_of_poses_is_carried_along():
    """Turning a changed camera equals changing the turned camera."""
    three_cameras = table1_rig()
    rig = uncertain(Rig({"a": three_cameras["left"], "b": three_cameras["right"]}))
    rectified, _ = rectify_pair(rig)
    assert rectified.parameters == tuple(
        f"{v}.{parameter}" for v in ("a", "b") for parameter in PARAMETER_NAMES
    )
    step = np.linalg.cholesky(rig.covariance)
    moved = np.zeros((len(rectified.parameters), len(step)))
    for k, column in enumerate(step.T):
        ends = []
        for sign in (-1, 1):
            values = dict(zip(rig.parameters, sign * column, strict=True))
            for view in ("a", "b"):
                old = rig[view]
                changed = Camera.from_degrees(
                    LENS,
                    **{
                        angle: getattr(old, angle) + values[f"{view}.{angle}"]
                        for angle in PARAMETER_NAMES[:4]
                    },
                )
                turn = rectified[view].pose.rotation @ old.pose.rotation.T
                pose = Pose.from_translation(
                    turn @ changed.pose.rotation, turn @ changed.pose.translation_mm
                )
                turned_rig = Rig({view: Camera(LENS, pose)})
                ends += [turned_rig.value(f"{view}.{name}") for name in PARAMETER_NAMES]
        half = len(ends) // 2
        moved[:, k] = (np.array(ends[half:]) - np.array(ends[:half])) / 2
    scale = np.sqrt(np.diag(rectified.covariance))
    np.testing.assert_allclose(
        rectified.covariance / np.outer(scale, scale),
        moved @ moved.T / np.outer(scale, scale),
        atol=1e-5,
    )


def test_the_covariance_stays_where_only_lenses_that_are_exact_change():
    three_cameras = table1_rig()
    bent = Rig(
        {
            n: Camera(DISTORTED_LENS, three_cameras[o].pose)
            for n, o in (("a", "left"), ("b", "right"))
        }
    )
    rig = uncertain(bent)
    undistorted = undistort_rig(rig)
    assert undistorted.parameters == rig.parameters
    np.testing.assert_allclose(undistorted.covariance, rig.covariance, rtol=1e-12)


def test_errors_of_lenses_that_change_leave_no_covariance():
    three_cameras = table1_rig()
    ideal = Rig({"a": three_cameras["left"], "b": three_cameras["right"]})
    bent = Rig({n: Camera(DISTORTED_LENS, camera.pose) for n, camera in ideal.items()})
    names = (*NAMES, "a.fx_px")
    assert undistort_rig(uncertain(bent, names)).parameters == ()
    assert rectify_pair(uncertain(ideal, names))[0].parameters == ()
    undistorted = undistort_rig(uncertain(ideal, names))
    assert set(undistorted.parameters) == set(names)
    # An axis that does not meet the sheet has no distance.
    away = uncertain(in_a_row(0.0, 80.0, turn=(0.0, 0.1, 0.0)), ("c0.pan_deg", "c1.pan_deg"))
    assert rectify_pair(away)[0].parameters == ()


@given(camera=cameras(DISTORTED_LENS), point=points_near_sheet())
@settings(max_examples=5)
def test_undistorting_a_pixel_is_projecting_into_the_new_picture(camera, point):
    new = undistort_rig(Rig({"a": camera}))["a"]
    uv_px = distort_pixels(
        DISTORTED_LENS,
        (np.linalg.inv(new.intrinsics.matrix) @ [*new.project(point), 1.0])[:2]
        * DISTORTED_LENS.focal_length_px
        + DISTORTED_LENS.principal_point_px,
    )
    np.testing.assert_allclose(uv_px, camera.project(point), atol=1e-8)


def test_the_border_goes_once_around():
    points = border_in_plane(LENS, np.eye(3))
    x, y = points.T
    area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    assert abs(area) == pytest.approx(511 * 479 / np.prod(LENS.focal_length_px), rel=1e-9)
    steps = np.abs(points - np.roll(points, -1, axis=0)).sum(axis=1)
    assert steps.max() < 1.2 * 512 / 32 / LENS.focal_length_px.min()
    assert len(list(itertools.groupby(map(tuple, points)))) == len(points)
