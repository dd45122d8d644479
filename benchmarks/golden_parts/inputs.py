"""Inputs of fixed seeds that several parts share: each is made once in a process."""

import zlib
from functools import cache

import cv2
import numpy as np
from picture_conditions import CONDITIONS, Case
from rig_parts.made import LENSES, SIZE_PX, boards, observed, rotation, seen
from rig_parts.pixels import NOISE, PERSPECTIVE, rendered

import trinoc
from simulation import Detector, block_scene, simulate_segments
from simulation.camera_picture.render import camera_picture
from trinoc.calib import CalibrationResult, Detection
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.io import demo_images, demo_pattern
from trinoc.synth import table1_lens, table1_rig

EXACT = trinoc.Systematics()
TERMS = trinoc.Systematics(print_scale_sigma=(0.0005, 0.0005), flatness_mm=0.1, aim_sigma_mm=0.2)
# Pan, tilt, swing (deg) and distance (mm) of the camera that takes delivered pictures.
POSE = (23.568, 38.616, -0.994, 472.894)
TARGETS: dict[str, AbstractTarget] = {
    "sheet": trinoc.Pattern.default(),
    "chessboard": trinoc.Chessboard(rows=8, columns=8, square_mm=20.0),
    "charuco": trinoc.Charuco(rows=8, columns=8, square_mm=20.0, marker_mm=15.0),
    "aprilgrid": trinoc.AprilGrid(rows=4, columns=4, tag_mm=32.0),
}
SIGMA_PX = {"sheet": 0.02, "chessboard": 0.1, "charuco": 0.1, "aprilgrid": 0.1}


def digest(*pictures: np.ndarray) -> int:
    """Checksum of the grey levels, to test that the inputs are the frozen ones."""
    return zlib.crc32(b"".join(np.ascontiguousarray(picture).tobytes() for picture in pictures))


@cache
def calibrated_demo() -> CalibrationResult:
    """The demo's rig by its circles, all else exact."""
    return trinoc.calibrate(
        demo_images("sheet"), demo_pattern(), table1_lens(), systematics=EXACT, method="points"
    )


@cache
def demo_segments() -> dict[str, trinoc.Segments]:
    return {view: trinoc.find_segments(image) for view, image in demo_images("scene").items()}


@cache
def demo_matches() -> trinoc.Matches:
    return trinoc.match_segments(demo_segments(), calibrated_demo().rig)


@cache
def blocks(seed: int = 900_001, count: int = 8):
    """Segments of a table with blocks by the paper's rig, and the truth."""
    return simulate_segments(block_scene(seed, count=count), table1_rig(), Detector(), seed=7)


def knocked_rig() -> trinoc.Rig:
    """The paper's rig, its left camera turned and moved a little."""
    rig = table1_rig()
    camera = rig["left"]
    moved = trinoc.Camera.from_degrees(
        camera.intrinsics,
        pan_deg=camera.pan_deg + 0.1,
        tilt_deg=camera.tilt_deg - 0.05,
        swing_deg=camera.swing_deg,
        distance_mm=camera.distance_mm + 0.3,
    )
    return trinoc.Rig({**dict(rig.items()), "left": moved})


def five_view_rig() -> trinoc.Rig:
    """The paper's three cameras and two more between them."""
    lens, rig = table1_lens(), table1_rig()
    more = {
        name: trinoc.Camera.from_degrees(
            lens, pan_deg=pan, tilt_deg=tilt, swing_deg=1.0, distance_mm=480.0
        )
        for name, pan, tilt in (("fourth", 11.0, 30.0), ("fifth", -14.0, 62.0))
    }
    return trinoc.Rig({**dict(rig.items()), **more})


@cache
def delivered(name: str, seed: int = 1) -> tuple[np.ndarray, trinoc.Intrinsics, Case]:
    """(picture, stated lens, condition) of a named condition."""
    condition, ideal = CONDITIONS[name], table1_lens()
    camera = condition.camera(ideal, POSE)
    picture = camera_picture(trinoc.Pattern.default(), camera, condition, seed=seed)
    return picture, condition.said_lens(ideal), condition


def shots(
    title: str, cameras: tuple[str, ...], count: int, seed: int = 0
) -> dict[str, list[Detection | None]]:
    """Simulated detections of a moved board, with noise, by camera and shot."""
    random = np.random.default_rng(seed)
    detections = observed(TARGETS[title], SIGMA_PX[title], boards(count, random), random)
    return {name: detections[name] for name in cameras}


def set_of_boards() -> tuple[trinoc.calib.BoardSet, dict[str, list[Detection]]]:
    """A block with a chessboard on either side, held between cameras that face each other."""
    target = trinoc.calib.BoardSet(
        {
            "first": trinoc.Chessboard(rows=8, columns=9, square_mm=20.0),
            "second": trinoc.Chessboard(rows=7, columns=10, square_mm=20.0),
        }
    )
    back = rotation([0.04, np.pi - 0.1, 0.02])
    cams = [np.eye(3, 4), np.column_stack([back, -back @ [60.0, 20.0, 1150.0]])]
    in_set = [np.eye(3, 4), np.column_stack([rotation([0.0, np.pi - 0.06, 0.0]), [9.0, 4, -60]])]
    random = np.random.default_rng(3)
    detections: dict[str, list[Detection]] = {"left": [], "right": []}
    for pose in boards(8, random):
        first = 0
        for camera, cam, board_in_set, board in zip(
            detections, cams, in_set, target.boards, strict=True
        ):
            both = _chained(cam, _chained(pose, board_in_set))
            lens = BrownConrady.from_parameters(np.array(LENSES[camera]))
            detections[camera].append(_simulated_detection(lens, both, board, first, random))
            first += len(board)
    return target, detections


def _chained(second: np.ndarray, first: np.ndarray) -> np.ndarray:
    turn = second[:, :3] @ first[:, :3]
    return np.column_stack([turn, second[:, :3] @ first[:, 3] + second[:, 3]])


def _simulated_detection(lens, cam_from_board, board, first: int, random) -> Detection:
    import jax

    with jax.enable_x64(True):
        exact = np.asarray(seen(lens, cam_from_board, board.centres_mm, board.radius_mm))
    rows = np.flatnonzero(((exact > 5) & (exact < np.array(SIZE_PX) - 6)).all(axis=1))
    return Detection(
        circle_index=first + rows,
        centres_px=exact[rows] + random.normal(0, 0.1, (len(rows), 2)),
        covariance_px2=np.tile(0.01 * np.eye(2), (len(rows), 1, 1)),
        shape_px2=np.full((len(rows), 2, 2), np.nan),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=SIZE_PX,
    )


@cache
def board_pictures(title: str, cameras: tuple[str, ...], count: int) -> dict[str, list[np.ndarray]]:
    """Rendered pictures of a moved board."""
    random = np.random.default_rng(5)
    poses = PERSPECTIVE.boards(count, random)
    pictures = {}
    for name in cameras:
        lens = PERSPECTIVE.lens(name)
        cams_from_board = [PERSPECTIVE.cam_from_board(name, pose) for pose in poses]
        clean = [
            rendered(TARGETS[title], lens, cam_from_board, fine=4)
            for cam_from_board in cams_from_board
        ]
        pictures[name] = [
            np.rint(np.clip(image + NOISE * random.normal(size=image.shape), 0, 255)).astype("u1")
            for image in clean
        ]
    return pictures


def arcs_picture() -> np.ndarray:
    """Discs, an ellipse and a box, blurred, with noise."""
    picture = np.full((240, 320), 60.0)
    cv2.circle(picture, (90, 110), 55, 180.0, -1, cv2.LINE_AA)
    cv2.ellipse(picture, (220, 90), (70, 35), 20, 0, 360, 120.0, -1, cv2.LINE_AA)
    cv2.rectangle(picture, (170, 150), (290, 215), 220.0, -1, cv2.LINE_AA)
    noise = np.random.default_rng(4).normal(0, 1.5, picture.shape)
    return np.rint(np.clip(cv2.GaussianBlur(picture, (0, 0), 0.8) + noise, 0, 255)).astype("u1")


def saturated_picture() -> np.ndarray:
    """The demo's scene, lit so that its bright faces saturate."""
    return np.clip(1.9 * demo_images("scene")["left"].astype(float), 0, 255).astype(np.uint8)
