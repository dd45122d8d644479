"""Cameras that never see the same board: errors over the bound and over the reported sigmas.

Two cameras with unknown lenses of four coefficients, and two boards that are fixed to each other in
a way that nobody knows; each camera sees a board of its own, never the other's. "around": a block
with a chessboard on its front and another one on its back is held between cameras that face each
other. "outward": cameras back to back are moved about between two walls with a board each. Corners
have the stated noise. The bound is the covariance of the least squares at it. Beside trinoc, on the
same corners: cv2.calibrateCamera for each camera, and then the closed form for a robot's arm and
the camera on it, which is what the joint fit starts from (OpenCV 5 has none).
"""

import time

import cv2
import jax
import numpy as np

from rig_parts.made import LENSES, SIZE_PX, points, rms, rotation, seen
from trinoc.calib import BoardSet, CalibrationResult, Detection
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.starts.connected import solve_hand_eye
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry import Pose
from trinoc.geometry.lenses.polynomial import BrownConrady

SIGMA_PX = 0.1
CAMERAS = ("left", "right")
BOARDS = (
    Chessboard(rows=8, columns=9, square_mm=20.0),
    Chessboard(rows=7, columns=10, square_mm=20.0),
)
TARGET = BoardSet(dict(zip(("first", "second"), BOARDS, strict=True)))
# cam_from_rig of the second camera, and set_from_board of the second board; both turn by 180
# degrees and some.
_BACK = rotation([0.04, np.pi - 0.1, 0.02])
SCENES = {
    "around": ((_BACK, [60.0, 20.0, 1150.0]), (rotation([0.0, np.pi - 0.06, 0.0]), [9.0, 4, -60])),
    "outward": (
        (_BACK, [30.0, 10.0, -120.0]),
        (rotation([0.05, np.pi - 0.08, 0.03]), [40.0, -30, 1300]),
    ),
}


def chained(second: np.ndarray, first: np.ndarray) -> np.ndarray:
    turn = second[:, :3] @ first[:, :3]
    return np.column_stack([turn, second[:, :3] @ first[:, 3] + second[:, 3]])


def inverse(motion: np.ndarray) -> np.ndarray:
    return np.column_stack([motion[:, :3].T, -motion[:, :3].T @ motion[:, 3]])


def scene(name: str) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """cam_from_rig of both cameras, and set_from_board of both boards."""
    (turn, centre), (board_turn, origin) = SCENES[name]
    second = np.column_stack([turn, -turn @ np.array(centre)])
    return [np.eye(3, 4), second], [np.eye(3, 4), np.column_stack([board_turn, origin])]


def observed(name: str, shots: int, random: np.random.Generator) -> dict[str, list]:
    """Detections of each camera's board, in shots in which both boards are fully visible."""
    cameras, boards = scene(name)
    detections: dict[str, list[Detection]] = {camera: [] for camera in CAMERAS}
    reach = 0.75 if name == "around" else 0.35
    while len(detections[CAMERAS[0]]) < shots:
        about, tilt = random.uniform(0, 2 * np.pi), random.uniform(0.4, 1.0) * reach
        turn = rotation([tilt * np.cos(about), tilt * np.sin(about), 0])
        turn = turn @ rotation([0, 0, random.uniform(-0.5, 0.5)]) @ np.diag([1.0, -1, -1])
        position_mm = [*random.uniform(-70, 70, 2), random.uniform(480, 650)]
        pose = np.column_stack([turn, position_mm])
        shot_detections, first = [], 0
        for camera, cam, in_set, board in zip(CAMERAS, cameras, boards, BOARDS, strict=True):
            lens = BrownConrady.from_parameters(np.array(LENSES[camera]))
            with jax.enable_x64(True):
                both = chained(cam, chained(pose, in_set))
                exact = np.asarray(seen(lens, both, board.centres_mm, board.radius_mm))
            count = len(board)
            if (
                both[:, 2] @ both[:, 3] < 0
                and ((exact > 5) & (exact < np.array(SIZE_PX) - 6)).all()
            ):
                shot_detections.append(
                    Detection(
                        circle_index=first + np.arange(count),
                        centres_px=exact + random.normal(0, SIGMA_PX, (count, 2)),
                        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (count, 1, 1)),
                        shape_px2=np.full((count, 2, 2), np.nan),
                        lines_px=np.full((2, 3), np.nan),
                        image_size_px=SIZE_PX,
                    )
                )
            first += count
        if len(shot_detections) == len(CAMERAS):
            for camera, detection in zip(CAMERAS, shot_detections, strict=True):
                detections[camera].append(detection)
    return detections


def errors(cameras: list[np.ndarray], boards: list[np.ndarray], name: str) -> dict[str, float]:
    """Pose errors of the second camera and the second board, in mm and degrees."""
    true_cameras, true_boards = scene(name)
    between = chained(cameras[1], inverse(cameras[0]))
    centre, true_centre = (inverse(pose)[:, 3] for pose in (between, true_cameras[1]))
    turn = cv2.Rodrigues(between[:, :3] @ true_cameras[1][:, :3].T)[0].ravel()
    in_set = chained(inverse(boards[0]), boards[1])
    board_turn = cv2.Rodrigues(in_set[:, :3] @ true_boards[1][:, :3].T)[0].ravel()
    named = {}
    for axis in range(3):
        letter = "xyz"[axis]
        named[f"right.centre_{letter}_mm"] = centre[axis] - true_centre[axis]
        named[f"right.turn_{letter}_deg"] = np.degrees(turn[axis])
        named[f"board.second.{letter}_mm"] = in_set[axis, 3] - true_boards[1][axis, 3]
        named[f"board.second.turn_{letter}_deg"] = np.degrees(board_turn[axis])
    return named


def by_trinoc(detections: dict[str, list], name: str) -> tuple[dict[str, float], CalibrationResult]:
    result = calibrate_rig(
        detections, TARGET, world="left", systematics=Systematics(), distortion=4
    )
    assert result.has_rig
    cameras = [np.asarray(result.rig[camera].cam_from_world) for camera in CAMERAS]
    deviations = errors(cameras, list(result.reference_from_board), name)
    for camera in CAMERAS:
        for key, true in zip(BrownConrady.parameter_names, LENSES[camera], strict=True):
            deviations[f"{camera}.{key}"] = result.value(f"{camera}.{key}") - true
    return deviations, result


def by_opencv(detections: dict[str, list], name: str) -> dict[str, float]:
    poses, deviations, first = [], {}, 0
    for camera, board in zip(CAMERAS, BOARDS, strict=True):
        local = [
            Detection(**{**vars(detection), "circle_index": detection.circle_index - first})
            for detection in detections[camera]
        ]
        pairs = [points(board, detection) for detection in local]
        start = np.array([[800.0, 0, 319.5], [0, 800.0, 239.5], [0, 0, 1]])
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            [p for p, _ in pairs], [q for _, q in pairs], SIZE_PX, start, np.zeros(5), flags=flags
        )
        values = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()[:5]]
        for key, value, true in zip(
            BrownConrady.parameter_names, values, LENSES[camera], strict=True
        ):
            deviations[f"{camera}.{key}"] = value - true
        poses.append(
            [
                np.column_stack([rotation(r), np.ravel(t)])
                for r, t in zip(turns, shifts, strict=True)
            ]
        )
        first += len(board)
    motions = solve_hand_eye(
        *([Pose(pose) for pose in camera_poses] for camera_poses in poses), TUNING
    )
    assert motions is not None
    cameras, boards = (pose.cam_from_world for pose in motions)
    return deviations | errors([np.eye(3, 4), cameras], [np.eye(3, 4), boards], name)


def made(name: str, trials: int, shots: int) -> None:
    rows: dict[str, list[list[float]]] = {}
    groups: list[str] = []
    seconds = []
    for trial in range(trials):
        detections = observed(name, shots, np.random.default_rng(trial))
        start = time.perf_counter()
        deviations, result = by_trinoc(detections, name)
        seconds.append(time.perf_counter() - start)
        keys = [key for key in deviations if result.sigma(key) > 0]
        groups = [
            "boards" if key.startswith("board") else "poses" if "_mm" in key or "_deg" in key
            else "lenses" for key in keys
        ]  # fmt: skip
        reported_sigma = np.array([result.sigma(key) for key in keys])
        bound = reported_sigma / np.mean([fit.sigma_factor for fit in result.fits.values()])
        mine = np.array([deviations[key] for key in keys])
        theirs = np.array([by_opencv(detections, name)[key] for key in keys])
        rows.setdefault("trinoc", []).append(list(mine / bound))
        rows.setdefault("cv2.calibrateCamera, then hand-eye", []).append(list(theirs / bound))
        rows.setdefault("trinoc, over its claimed sigmas", []).append(list(mine / reported_sigma))
    print(f"\n{name}: 2 cameras, 2 boards, {shots} shots, {SIGMA_PX} px, {trials} trials")
    print("error over the bound (rms)                     lenses    poses   boards")
    for chain, table in rows.items():
        by_group = [
            rms(np.array(table)[:, [k for k, label in enumerate(groups) if label == group]])
            for group in ("lenses", "poses", "boards")
        ]
        print(f"  {chain:42} {by_group[0]:9.2f} {by_group[1]:8.2f} {by_group[2]:8.2f}")
    print(f"  {np.median(seconds):.1f} s a rig (median)", flush=True)


def run(trials: int, shots: int) -> None:
    """Print a table for each scene."""
    for name in SCENES:
        made(name, trials, shots)
