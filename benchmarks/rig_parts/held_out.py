"""Errors in held-out shots of two real stereo sets, against OpenCV.

Every second shot tells lenses and rig; of each other shot the board's pose alone is fitted, to what
one camera saw of it. What remains in that camera is the lens's error, what the other camera then
shows elsewhere the rig's. Then the other way round. All chains see the same places: trinoc's
detections without what trinoc took for located wrongly. trinoc is fitted by its own rule, with the
board as drawn (but for scale and warp) and with its places found along; OpenCV by calibrateCamera
with five coefficients and stereoCalibrate, lenses held or free, and solvePnP with refinement.
With `pixels` also trinoc's fit of the grey levels, whose places are those that these show.
"""

from pathlib import Path

import cv2
import numpy as np

from trinoc.calib import CalibrationResult, detect_target
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics

Lens = tuple[np.ndarray, np.ndarray]
Seen = tuple[np.ndarray, np.ndarray]
PRECISE = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-10)


def sets(data: Path) -> dict[str, tuple[AbstractTarget, dict[str, list[Path]]]]:
    chess, plate = data / "stereo_chessboard", data / "stereo_circle_plate"
    names = ("left", "right")
    return {
        "stereo_circle_plate": (
            Pattern.circle_grid(rows=10, columns=10, pitch_mm=30.0, radius_mm=5.0),
            {name: sorted(plate.glob(f"{name}_*.png")) for name in names},
        ),
        "stereo_chessboard": (
            Chessboard(rows=6, columns=9, square_mm=1.0),
            {name: sorted(chess.glob(f"{name}*.jpg")) for name in names},
        ),
    }


def observed_corners(result: CalibrationResult) -> dict[int, dict[int, Seen]]:
    """For each camera and shot: points of the board (m, 3) and their pixels (m, 2)."""
    observations: dict[int, dict[int, Seen]] = {0: {}, 1: {}}
    for view in result.views:
        index = view.detection.circle_index[view.used]
        order = np.argsort(index)
        board = np.pad(result.board.centres_mm[index[order]], ((0, 0), (0, 1)))
        uv_px = view.detection.centres_px[view.used][order]
        observations[view.camera][view.shot] = board.astype(np.float32), uv_px.astype(np.float32)
    return observations


def opencv_rig(
    observations: dict[int, dict[int, Seen]], size_px: tuple[int, int], *, free: bool
) -> tuple[list[Lens], np.ndarray]:
    """Lenses of both cameras, and right_from_left."""
    lenses = []
    for by_shot in observations.values():
        board, uv_px = zip(*by_shot.values(), strict=True)
        _, matrix, distortion, *_ = cv2.calibrateCamera(
            board, uv_px, size_px, None, None, criteria=PRECISE
        )
        lenses.append((matrix, distortion))
    board, left, right = [], [], []
    for shot in sorted(set(observations[0]) & set(observations[1])):
        (first, uv), (second, other) = observations[0][shot], observations[1][shot]
        # Nodes of one board are the same in every shot.
        both = {tuple(p): k for k, p in enumerate(first.tolist())}
        pairs = [(both[tuple(p)], k) for k, p in enumerate(second.tolist()) if tuple(p) in both]
        a, b = np.array(pairs).T
        board.append(first[a])
        left.append(uv[a])
        right.append(other[b])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS if free else cv2.CALIB_FIX_INTRINSIC
    (m1, d1), (m2, d2) = lenses
    _, m1, d1, m2, d2, turn, shift, *_ = cv2.stereoCalibrate(
        board, left, right, m1, d1, m2, d2, size_px, flags=flags, criteria=PRECISE
    )
    return [(m1, d1), (m2, d2)], np.column_stack([turn, shift.ravel()])


def opencv_errors(
    observations: dict[int, dict[int, Seen]], size_px: tuple[int, int], *, free: bool
) -> tuple[list[float], list[float]]:
    """Rms errors per camera, with the board's pose from this camera and from the other one."""
    shots = sorted(set(observations[0]) | set(observations[1]))
    own_errors: list[list[np.ndarray]] = [[], []]
    across: list[list[np.ndarray]] = [[], []]
    for remainder in (0, 1):
        half, held_out_shots = shots[remainder::2], shots[1 - remainder :: 2]
        trained = {c: {s: each[s] for s in half if s in each} for c, each in observations.items()}
        lenses, right_from_left = opencv_rig(trained, size_px, free=free)
        for source in (0, 1):
            step = right_from_left if source == 0 else inverse(right_from_left)
            for shot in held_out_shots:
                if shot not in observations[source]:
                    continue
                board, uv_px = observations[source][shot]
                _, turn, shift = cv2.solvePnP(board, uv_px, *lenses[source])
                turn, shift = cv2.solvePnPRefineLM(board, uv_px, *lenses[source], turn, shift,
                                                   criteria=PRECISE)  # fmt: skip
                pose = np.column_stack([cv2.Rodrigues(turn)[0], shift.ravel()])
                own_errors[source].append(missed(pose, lenses[source], observations[source][shot]))
                if shot in observations[1 - source]:
                    there = np.column_stack(
                        [step[:, :3] @ pose[:, :3], step[:, :3] @ pose[:, 3] + step[:, 3]]
                    )
                    other = missed(there, lenses[1 - source], observations[1 - source][shot])
                    across[1 - source].append(other)
    return [rms(each) for each in own_errors], [rms(each) for each in across]


def missed(pose: np.ndarray, lens: Lens, observation: Seen) -> np.ndarray:
    board, uv_px = observation
    projected, _ = cv2.projectPoints(board, cv2.Rodrigues(pose[:, :3])[0], pose[:, 3], *lens)
    return projected.reshape(-1, 2) - uv_px


def inverse(pose: np.ndarray) -> np.ndarray:
    turn = pose[:, :3].T
    return np.column_stack([turn, -turn @ pose[:, 3]])


def rms(errors: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1))))


def row(
    title: str, own_px: list[float], across_px: list[float], within: float | None = None
) -> None:
    cells = "".join(f"{value:9.4f}" for value in (*own_px, *across_px))
    print(f"  {title:44}{cells}" + ("" if within is None else f"{within:9.4f}"), flush=True)


def trinoc_row(title: str, result: CalibrationResult) -> None:
    errors = result.cross_validation
    assert errors is not None, result.summary()
    own_px, across_px = ([by_camera[name] for name in result.cameras]
                   for by_camera in (errors.own_px, errors.across_px))  # fmt: skip
    row(title, own_px, across_px, result.rms_px())


def run(data: Path, *, pixels: bool) -> None:
    """Print a table for each set."""
    for name, (target, files) in sets(data).items():
        images = {
            c: [np.asarray(cv2.imread(str(f), 0)) for f in paths] for c, paths in files.items()
        }
        detections = {
            c: [detect_target(image, target) for image in shots] for c, shots in images.items()
        }
        result = calibrate_rig(detections, target)
        size_px = next(iter(detections.values()))[0].image_size_px
        print(f"\n{name}: {len(result.shots)} shots; rms length of errors (px) in shots held out")
        print(f"{'board placed by':46}{'itself':>18}{'the other':>18}   fitted")
        print(f"{'in':46}" + "".join(f"{c:>9}" for c in (*files, *files)) + "      all")
        observations = observed_corners(result)
        row(
            "cv2, lenses held in stereoCalibrate", *opencv_errors(observations, size_px, free=False)
        )
        row("cv2, lenses free in stereoCalibrate", *opencv_errors(observations, size_px, free=True))
        trinoc_row(
            "trinoc, an exact board", calibrate_rig(detections, target, systematics=Systematics())
        )
        trinoc_row("trinoc", result)
        if pixels:
            trinoc_row("trinoc, pixels", calibrate_rig(images, target, method="pixels"))
