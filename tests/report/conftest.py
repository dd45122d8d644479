"""A made-up calibration and a made-up scene, exact and quick, for the tests of the report."""

from collections.abc import Mapping

import cv2
import jax
import numpy as np
import pytest

from tests.geometry.conics import (
    image_of_circle,
    pixel_from_sheet_homography,
    shape_of_dual_conic,
)
from tests.geometry.trifocal import normalised_line
from trinoc.calib import (
    CalibrationResult,
    CameraFit,
    Detection,
    Status,
)
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry import project
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.precision import in_float64

PARAMETERS = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
SIGMA = (0.0013, 0.0008, 0.0011, 0.0045)
TABLE_1 = {
    "upper": (2.143, 53.252, -1.714, 476.369),
    "right": (23.568, 38.616, -0.994, 472.894),
    "left": (-23.241, 38.264, 0.872, 474.471),
}


def made_up_rig(distortion: tuple[float, ...] | None = None) -> Rig:
    """Table 1's rig, with a diagonal covariance."""
    lens = Intrinsics(
        focal_length_mm=16,
        pixel_pitch_mm=(0.0162, 0.0134),
        image_size_px=(512, 480),
        distortion=distortion,
    )
    cameras = {
        name: Camera.from_degrees(
            lens, pan_deg=pan, tilt_deg=tilt, swing_deg=swing, distance_mm=distance
        )
        for name, (pan, tilt, swing, distance) in TABLE_1.items()
    }
    parameters = [f"{name}.{parameter}" for name in cameras for parameter in PARAMETERS]
    return Rig(
        cameras, parameters=parameters, covariance=np.diag(np.square(np.tile(SIGMA, len(cameras))))
    )


def made_up_pattern() -> Pattern:
    """6 x 6 circles at 20 mm, four of them rings, and lines between the middle rows."""
    lattice = np.stack(np.meshgrid(np.arange(6), np.arange(6), indexing="ij"), axis=-1)
    lattice = lattice.reshape(-1, 2)
    inner = np.where((lattice[:, 0] < 2) & (lattice[:, 1] < 2), 3.0, 0.0)
    return Pattern(
        "made-up sheet",
        (lattice - 2.5) * 20.0,
        np.full(36, 6.0),
        inner,
        lattice,
        1.0,
        (60.0, 60.0),
        "stop",
        1.5,
    )


@in_float64
def _detection(camera: Camera, pattern: Pattern, noise_px: np.ndarray) -> Detection:
    centres = jax.vmap(image_of_circle_centre, in_axes=(None, 0, 0))(
        camera, pattern.centres_mm, pattern.radius_mm
    )
    conics = jax.vmap(image_of_circle, in_axes=(None, 0, 0))(
        camera, pattern.centres_mm, pattern.radius_mm
    )
    to_lines = np.linalg.inv(pixel_from_sheet_homography(camera)).T
    lines = [normalised_line(to_lines @ line) for line in np.eye(3)[[1, 0]]]
    count = len(pattern)
    return Detection(
        np.arange(count),
        np.asarray(centres) + noise_px,
        np.broadcast_to(np.eye(2) * 0.004**2, (count, 2, 2)),
        np.asarray(jax.vmap(shape_of_dual_conic)(conics)),
        np.stack([np.asarray(line) for line in lines]),
        camera.image_size_px,
    )


def made_up_result(rig: Rig) -> CalibrationResult:
    """A calibration whose residuals are known noise; one camera with a note."""
    pattern, random = made_up_pattern(), np.random.default_rng(1)
    fits = {}
    for name, camera in rig.items():
        noise = random.normal(scale=0.004, size=(len(pattern), 2))
        notes = ("Circle 7 was left out as an outlier.",) if name == "left" else ()
        detection = _detection(camera, pattern, noise)
        used = np.arange(len(pattern)) != (7 if notes else -1)
        fits[name] = CameraFit(-noise, used, 4, 1.02, (), notes, detections=(detection,))
    return CalibrationResult(
        rig,
        dict.fromkeys(rig, Status.CONVERGED),
        rig.parameters,
        np.array([value for row in TABLE_1.values() for value in row]),
        np.asarray(rig.covariance),
        fits,
        pattern,
    )


def made_up_sheet_pictures(rig: Rig) -> dict[str, np.ndarray]:
    """The sheet as each camera sees it, black on light grey, without blur."""
    pattern, pictures = made_up_pattern(), {}
    width, height = rig.cameras[0].image_size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    pixels = np.stack([u, v, np.ones_like(u)], axis=-1).astype(np.float64)
    for name, camera in rig.items():
        sheet = pixels @ np.linalg.inv(_homography(camera)).T
        sheet = sheet[..., :2] / sheet[..., 2:]
        offset = np.linalg.norm(sheet[..., None, :] - pattern.centres_mm, axis=-1)
        ink = ((offset < pattern.radius_mm) & (offset > pattern.inner_radius_mm)).any(axis=-1)
        ink |= (np.abs(sheet) < 0.5).any(axis=-1) & (np.abs(sheet) < 60).all(axis=-1)
        pictures[name] = np.where(ink, 40, 220).astype(np.uint8)
    return pictures


@in_float64
def _homography(camera: Camera) -> np.ndarray:
    return np.asarray(pixel_from_sheet_homography(camera))


@in_float64
def _projected(rig: Rig, points_mm: np.ndarray) -> np.ndarray:
    views = [jax.vmap(project, in_axes=(None, 0))(camera, points_mm) for _, camera in rig.items()]
    return np.stack([np.asarray(view) for view in views])


def made_up_blocks() -> np.ndarray:
    """(t, 2, 3) edges of three boxes on the table, in mm."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    edges = [
        (i, j) for i in range(8) for j in range(i) if np.abs(corners[i] - corners[j]).sum() == 1
    ]
    boxes = []
    for corner, size, turn in (
        ((-45, -10, 0), (35, 25, 30), 0.3),
        ((10, -30, 0), (25, 30, 18), -0.5),
        ((5, 20, 0), (40, 12, 24), 0.1),
    ):
        c, s = np.cos(turn), np.sin(turn)
        box_corners = corners * size @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + corner
        boxes.append(box_corners[np.array(edges)])
    return np.concatenate(boxes)


def made_up_matches(rig: Rig) -> tuple[dict[str, Segments], Matches]:
    """Segments of the blocks' edges in every view, and tracks; every fifth seen in two views."""
    edges, random = made_up_blocks(), np.random.default_rng(2)
    count = len(edges)
    uv = _projected(rig, edges.reshape(-1, 3)).reshape(len(rig), count, 2, 2)
    spurious = random.uniform(40, 440, size=(len(rig), 6, 1, 2)) + random.normal(
        scale=20, size=(len(rig), 6, 2, 2)
    )
    index = np.tile(np.arange(count)[:, None], (1, len(rig)))
    hidden = np.arange(0, count, 5)
    index[hidden, hidden % len(rig)] = -1
    fragments = np.where((index >= 0)[..., None, None], uv.transpose(1, 0, 2, 3), np.nan)
    reasons = {}
    for view, name in enumerate(rig):
        reason_column = np.full(count + 6, "no partner in the zone", dtype="<U32")
        reason_column[index[index[:, view] >= 0, view]] = "matched"
        reasons[name] = reason_column
    covariance = np.tile(np.diag([0.2, 0.3, 0.4, 0.2, 0.3, 0.4]) ** 2, (count, 1, 1))
    segments = {
        name: Segments.from_endpoints(np.concatenate([uv[view], spurious[view]]))
        for view, name in enumerate(rig)
    }
    matches = Matches(
        rig.names,
        index,
        fragments,
        edges,
        covariance,
        np.where((index >= 0).all(axis=1), "trinocular", "binocular"),
        np.linspace(0.6, 0.999, count),
        np.linspace(0.0, 0.3, count),
        reasons,
        {"candidate_pairs": 412, "candidate_triples": 118, "triples": 28, "pairs": 8},
    )
    return segments, matches


def made_up_scene_pictures(segments: Mapping[str, Segments]) -> dict[str, np.ndarray]:
    """Grey pictures with the segments drawn in."""
    pictures = {}
    for name, view_segments in segments.items():
        picture = np.full((480, 512), 150, np.uint8)
        for first, second in np.asarray(view_segments.endpoints_px).round().astype(int):
            cv2.line(picture, first.tolist(), second.tolist(), 60, 1, cv2.LINE_AA)
        pictures[name] = cv2.GaussianBlur(picture, (0, 0), 0.8)
    return pictures


@pytest.fixture(scope="session")
def rig() -> Rig:
    return made_up_rig()


@pytest.fixture(scope="session")
def result(rig: Rig) -> CalibrationResult:
    return made_up_result(rig)


@pytest.fixture(scope="session")
def sheet_pictures(rig: Rig) -> dict[str, np.ndarray]:
    return made_up_sheet_pictures(rig)


@pytest.fixture(scope="session")
def segments_and_matches(rig: Rig) -> tuple[dict[str, Segments], Matches]:
    return made_up_matches(rig)


@pytest.fixture(scope="session")
def segments(segments_and_matches: tuple[dict[str, Segments], Matches]) -> dict[str, Segments]:
    return segments_and_matches[0]


@pytest.fixture(scope="session")
def matches(segments_and_matches: tuple[dict[str, Segments], Matches]) -> Matches:
    return segments_and_matches[1]


@pytest.fixture(scope="session")
def scene_pictures(segments: dict[str, Segments]) -> dict[str, np.ndarray]:
    return made_up_scene_pictures(segments)
