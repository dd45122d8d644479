"""Maps agree with OpenCV, and the new pictures agree with the projections of their cameras."""

from typing import Any

import cv2
import numpy as np
import pytest

import trinoc
from tests.geometry.strategies import DISTORTED_LENS, LENS
from tests.geometry.test_rectification import FISHEYE, SKEWED
from trinoc.calib.detection.registry import detect_pattern
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import distort_pixels
from trinoc.geometry.lenses.splined import SPLINED
from trinoc.image.ideal_pictures import picture_maps, rectify, undistort
from trinoc.io.demo import demo_images, demo_pattern
from trinoc.synth.rigs import table1_rig

# Its stubs know no arrays of JAX.
OPENCV: Any = cv2
RATIONAL = trinoc.Intrinsics(
    image_size_px=(640, 480),
    focal_length_px=(520.0, 525.0),
    distortion=(0.2, -0.1, 0.001, -0.002, 0.03, 0.4, -0.02, 0.01),
    distortion_model="rational",
)


@pytest.mark.parametrize("alpha", [0.0, 1.0])
@pytest.mark.parametrize("lens", [DISTORTED_LENS, RATIONAL], ids=["brown", "rational"])
def test_maps_are_those_of_opencv(lens, alpha):
    ideal, maps = undistort(lens, alpha=alpha)
    theirs = OPENCV.initUndistortRectifyMap(
        lens.matrix, lens.distortion, np.eye(3), ideal.matrix, lens.image_size_px, cv2.CV_32FC1
    )
    np.testing.assert_allclose(maps.map_x, theirs[0], atol=1e-3)
    np.testing.assert_allclose(maps.map_y, theirs[1], atol=1e-3)


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_maps_of_a_fisheye_are_those_of_opencv(alpha):
    ideal, maps = undistort(FISHEYE, alpha=alpha)
    theirs = OPENCV.fisheye.initUndistortRectifyMap(
        FISHEYE.matrix, FISHEYE.distortion, np.eye(3), ideal.matrix, (640, 480), cv2.CV_32FC1
    )
    np.testing.assert_allclose(maps.map_x, theirs[0], atol=1e-3)
    np.testing.assert_allclose(maps.map_y, theirs[1], atol=1e-3)


def test_maps_of_a_rectified_rig_are_those_of_opencv():
    three_cameras = table1_rig()
    rig = trinoc.Rig(
        {name: Camera(DISTORTED_LENS, three_cameras[name].pose) for name in ("left", "right")}
    )
    rectified = rectify(rig)
    for name, camera in rig.items():
        turn = rectified.rig[name].pose.rotation @ camera.pose.rotation.T
        theirs = OPENCV.initUndistortRectifyMap(
            *(DISTORTED_LENS.matrix, DISTORTED_LENS.distortion, turn),
            *(rectified.rig[name].intrinsics.matrix, LENS.image_size_px, cv2.CV_32FC1),
        )
        np.testing.assert_allclose(rectified.maps[name].map_x, theirs[0], atol=1e-3)
        np.testing.assert_allclose(rectified.maps[name].map_y, theirs[1], atol=1e-3)


def test_a_map_is_the_projection_of_any_lens():
    """This holds for skew, splines, and pictures of another size."""
    model = next(iter(SPLINED.values()))
    start = model.from_parameters(np.zeros(len(model.parameter_names)))
    steps = np.random.default_rng(1).normal(scale=2e-3, size=len(start.parameters))
    steps[:4] = 987.0, 990.0, 250.0, 243.0
    extent = [k for k, name in enumerate(model.parameter_names) if name in model.never_fitted]
    steps[extent] = np.log(0.4)
    splined = trinoc.Intrinsics.of_lens(model.from_parameters(steps), (512, 480))
    for lens in (SKEWED, splined):
        ideal, maps = undistort(lens, image_size_px=(300, 200))
        assert maps.map_x.shape == (200, 300)
        assert maps.size_px == lens.image_size_px
        u, v = np.array([(0, 0), (299, 0), (120, 77), (299, 199)]).T
        normalised = np.stack([u, v, np.ones(4)], axis=1) @ np.linalg.inv(ideal.matrix).T
        undistorted = (normalised @ lens.matrix.T)[:, :2]
        mapped_px = np.stack([maps.map_x[v, u], maps.map_y[v, u]], axis=1)
        np.testing.assert_allclose(mapped_px, distort_pixels(lens, undistorted), atol=1e-3)


def test_nothing_is_shown_twice_beyond_the_fold():
    """OpenCV's polynomial returns into the picture beyond the fold."""
    lens = trinoc.Intrinsics(
        image_size_px=(640, 480), focal_length_px=560.0, distortion=(-0.45, 0.0, 0.0, 0.0, 0.0)
    )
    maps = picture_maps(
        lens,
        trinoc.Intrinsics(image_size_px=(900, 900), focal_length_px=150.0),
        np.eye(3),
    )
    middle = maps.valid[450]
    assert not middle[0]
    assert np.count_nonzero(np.diff(middle.astype(int))) == 2
    back = np.diag([-1.0, 1.0, -1.0])
    assert not picture_maps(lens, LENS, back).valid.any()


def test_an_ideal_lens_leaves_pictures_as_they_are():
    picture = np.random.default_rng(2).integers(0, 256, (480, 512)).astype(np.uint8)
    np.testing.assert_array_equal(undistort(LENS).maps.resample(picture), picture)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("channels", [(), (1,), (3,)])
def test_depth_and_colours_are_kept(dtype, channels):
    u, v = np.meshgrid(np.arange(512), np.arange(480))
    picture = np.broadcast_to(
        (u + v).reshape(480, 512, *(1,) * len(channels)), (480, 512, *channels)
    )
    undistorted = undistort(DISTORTED_LENS, alpha=1.0)
    resampled = undistorted.maps.resample((picture / 4).astype(dtype))
    assert (resampled.dtype, resampled.shape) == (dtype, picture.shape)
    assert not resampled[~undistorted.maps.valid].any()
    inner = (undistorted.maps.map_x > 2) & (undistorted.maps.map_x < 509) & undistorted.maps.valid
    expected = (undistorted.maps.map_x + undistorted.maps.map_y) / 4
    assert np.abs(resampled.reshape(480, 512, -1)[..., 0] - expected)[inner].max() < 1.1


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros((48, 51), np.uint8), "51 x 48 px, but the lens belongs to pictures of 512 x 480"),
        (np.zeros(7, np.uint8), "Give one of that size"),
        (np.zeros((480, 512), bool), "The picture has type bool"),
    ],
)
def test_what_is_no_picture_of_the_lens_is_refused(picture, message):
    with pytest.raises(InputError, match=message):
        undistort(LENS).maps.resample(picture)


def test_a_camera_that_is_not_there_is_named():
    undistorted = undistort(table1_rig())
    with pytest.raises(InputError, match='no camera "top"'):
        undistorted.resample({"top": np.zeros((480, 512), np.uint8)})


def seen_edges(picture: np.ndarray, rows: slice) -> np.ndarray:
    """Sum of the absolute vertical grey changes in each row."""
    smooth = cv2.GaussianBlur(picture.astype(np.float64), (0, 0), 1.5)
    return np.abs(np.diff(smooth, axis=0))[rows].sum(axis=1)


def test_rows_of_the_demo_s_pictures_correspond():
    """The edge strength per row correlates best between both pictures at a shift of 0 rows."""
    three_cameras, pictures = table1_rig(), demo_images("sheet")
    rectified = rectify(
        trinoc.Rig({name: three_cameras[name] for name in ("left", "right")}), alpha=0.5
    )
    resampled = rectified.resample({name: pictures[name] for name in ("left", "right")})
    left, right = (seen_edges(resampled[name], slice(150, 330)) for name in ("left", "right"))
    best = max(
        range(-20, 21),
        key=lambda shift: np.corrcoef(left[20:-20], np.roll(right, shift)[20:-20])[0, 1],
    )
    assert best == 0


def test_circles_of_the_sheet_are_found_in_equal_rows():
    three_cameras, pictures = table1_rig(), demo_images("sheet")
    rectified = rectify(trinoc.Rig({name: three_cameras[name] for name in ("left", "right")}))
    resampled = rectified.resample({name: pictures[name] for name in ("left", "right")})
    pattern = demo_pattern()
    centres = {}
    for name, picture in resampled.items():
        detection = detect_pattern(picture, pattern)
        centres[name] = np.full((len(pattern), 2), np.nan)
        centres[name][detection.circle_index] = detection.centres_px
    first, second = centres.values()
    off = (first - second)[:, 1]
    off = off[np.isfinite(off)]
    assert len(off) > 20
    assert np.sqrt(np.mean(off**2)) < 0.02
