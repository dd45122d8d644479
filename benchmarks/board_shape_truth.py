"""Bias and sigmas of focal length and principal point from simulated boards of wrong shape.

    python benchmarks/board_shape_truth.py [--trials 12] [--shots 16] [--cases mix,bends]

One camera (640 x 480 px, f = 530 px) sees a chessboard of 9 x 6 corners of 25 mm, noise .06 px. The
board is held so that it fills 30 to 60 % of the image and tilts up to 40 degrees. Cases:

    flat     the board is exact
    warp     its middle rises by .2 to 1 mm
    smooth   height of random low order, .2 mm
    print    corners displaced in the plane by random low order, .06 mm
    shear    the sides of the print are not perpendicular by .05 %
    mix      height .25 mm, stretch .07 %, smooth and single displacements of .02 mm
    bends    the board bends differently in each shot, .2 mm
    shutter  a rolling shutter and a board that moves, .4 px over the image

Columns: bias and root mean square error of the mean focal length and of the principal point, in
1e-4 of the focal length, and error over reported sigma (root mean square). "OpenCV" and "exact"
take the board as drawn; "warp" has its stretch and two warps free; "default" is calibrate_rig.
The result that the default of trinoc rests on: a board that is taken as flat biases focal lengths
by several reported sigmas, whatever the sigmas are enlarged by; a free shape does not.
"""

import argparse
from unittest import mock

import cv2
import numpy as np

from trinoc.calib import Detection, rig_calibration, shots_fit
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.uncertainty.systematics import Systematics

SIZE_PX, SIGMA_PX, FOCAL_PX = (640, 480), 0.06, 530.0
MATRIX = np.array([[FOCAL_PX, 0, 333.0], [0, 1.001 * FOCAL_PX, 235.0], [0, 0, 1]])
DISTORTION = np.array([-0.28, 0.09, 0.0008, -0.0004, -0.01])
BOARD = Chessboard(rows=6, columns=9, square_mm=25.0)
PLACES_MM = np.pad(np.asarray(BOARD.centres_mm), ((0, 0), (0, 1)))
U, V = (PLACES_MM[:, :2] / np.abs(PLACES_MM[:, :2]).max(axis=0)).T
CASES = ("flat", "warp", "smooth", "print", "shear", "mix", "bends", "shutter")


def draw_poses(random: np.random.Generator, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation vector and translation of boards that lie in the image."""
    poses: list[tuple[np.ndarray, np.ndarray]] = []
    size, extent_mm = np.array(SIZE_PX), np.ptp(PLACES_MM[:, 0]) + 25.0
    while len(poses) < count:
        share = np.sqrt(random.uniform(0.3, 0.6))
        depth_mm = FOCAL_PX * extent_mm / (share * SIZE_PX[0])
        about, tilt = random.uniform(0, 2 * np.pi), np.radians(random.uniform(5, 40))
        turn = cv2.Rodrigues(tilt * np.array([np.cos(about), np.sin(about), 0.0]))[0]
        roll = cv2.Rodrigues(np.array([0.0, 0.0, random.normal(0, 0.15)]))[0]
        turn = turn @ roll @ np.diag([1.0, -1.0, -1.0])
        aside = random.uniform(-0.5, 0.5, 2) * (1 - 0.75 * share) * size * depth_mm / FOCAL_PX
        pose = cv2.Rodrigues(turn)[0], np.array([*aside, depth_mm])
        pixels = cv2.projectPoints(PLACES_MM, *pose, MATRIX, None)[0][:, 0]
        if np.all((pixels > 0.02 * SIZE_PX[0]) & (pixels < size - 0.02 * SIZE_PX[0])):
            poses.append(pose)
    return poses


def draw_smooth(random: np.random.Generator, rms: float, lowest: int, highest: int) -> np.ndarray:
    """A random polynomial over the board with the given root mean square, its plane removed."""
    terms = [
        random.normal() / (d - lowest + 1) * U**k * V ** (d - k)
        for d in range(lowest, highest + 1)
        for k in range(d + 1)
    ]
    plane = np.column_stack([np.ones_like(U), U, V])
    total = np.sum(terms, axis=0)
    total = total - plane @ np.linalg.lstsq(plane, total)[0]
    return total * rms / np.sqrt(np.mean(total**2))


def draw_shapes(case: str, random: np.random.Generator, shots: int) -> np.ndarray:
    """Corners of the board in each shot, (s, n, 3) mm."""
    shape = np.tile(PLACES_MM, (shots, 1, 1))
    x, y = PLACES_MM[:, :2].T
    if case == "warp":
        shape[:, :, 2] += random.choice([-1, 1]) * random.uniform(0.2, 1.0) * (1 - U * U)
    elif case == "smooth":
        shape[:, :, 2] += draw_smooth(random, 0.2, 2, 4)
    elif case == "print":
        for axis in (0, 1):
            shape[:, :, axis] += draw_smooth(random, 0.06, 1, 3)
    elif case == "shear":
        shape[:, :, 0] += random.choice([-1, 1]) * 1e-3 * y
    elif case == "mix":
        shape[:, :, 2] += draw_smooth(random, 0.25, 2, 4)
        shape[:, :, 0] += 7e-4 * random.normal() * x + draw_smooth(random, 0.02, 2, 3)
        shape[:, :, :2] += random.normal(0, 0.02, (len(U), 2))
    elif case == "bends":
        rise = random.normal([0.3, 0.0, 0.0], [0.2, 0.1, 0.1], (shots, 3))
        shape[:, :, 2] += rise @ np.stack([1 - U * U, 1 - V * V, U * V])
    return shape


def draw_detections(case: str, random: np.random.Generator, shots: int) -> list[Detection]:
    """Simulated detections of a board, with the noise that they report."""
    detections = []
    shapes = draw_shapes(case, random, shots)
    for shape, pose in zip(shapes, draw_poses(random, shots), strict=True):
        pixels = cv2.projectPoints(shape, *pose, MATRIX, DISTORTION)[0][:, 0]
        if case == "shutter":
            late = 2 * pixels[:, 1:] / SIZE_PX[1] - 1
            pixels = pixels + random.normal(0, 0.4, 2) * late
        detections.append(
            Detection(
                circle_index=np.arange(len(U)),
                centres_px=pixels + random.normal(0, SIGMA_PX, pixels.shape),
                covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (len(U), 1, 1)),
                shape_px2=np.full((len(U), 2, 2), np.nan),
                lines_px=np.full((2, 3), np.nan),
                image_size_px=SIZE_PX,
            )
        )
    return detections


Estimate = tuple[np.ndarray, np.ndarray]


def by_opencv(detections: list[Detection]) -> Estimate:
    """fx, fy, cx, cy and their sigmas."""
    board_points = [PLACES_MM.astype(np.float32)] * len(detections)
    pixels = [detection.centres_px.astype(np.float32) for detection in detections]
    _, matrix, _, _, _, sigmas, *_ = cv2.calibrateCameraExtended(
        board_points, pixels, SIZE_PX, None, None
    )
    return matrix[[0, 1, 0, 1], [0, 1, 2, 2]], sigmas.ravel()[:4]


def by_trinoc(
    detections: list[Detection], systematics: Systematics | None, *, has_shape: bool
) -> Estimate:
    """fx, fy, cx, cy and their sigmas by calibrate_rig."""
    names = [f"camera.{parameter}_px" for parameter in ("fx", "fy", "cx", "cy")]
    with mock.patch.object(
        shots_fit,
        "with_board_shape",
        shots_fit.with_board_shape if has_shape else lambda fit: fit,
    ):
        result = rig_calibration.calibrate_rig(
            {"camera": detections}, BOARD, systematics=systematics
        )
    return (
        np.array([result.value(name) for name in names]),
        np.array([result.sigma(name) for name in names]),
    )


METHODS = {
    "OpenCV": by_opencv,
    "exact": lambda detections: by_trinoc(detections, Systematics(), has_shape=False),
    "warp": lambda detections: by_trinoc(detections, None, has_shape=False),
    "default": lambda detections: by_trinoc(detections, None, has_shape=True),
}


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--shots", type=int, default=16)
    parser.add_argument("--cases", default=",".join(CASES))
    options = parser.parse_args()
    true = MATRIX[[0, 1, 0, 1], [0, 1, 2, 2]]
    print("case     method     f bias    rms   centre rms   error / sigma of f   of the centre")
    for case in options.cases.split(","):
        errors: dict[str, list[np.ndarray]] = {name: [] for name in METHODS}
        normalised: dict[str, list[np.ndarray]] = {name: [] for name in METHODS}
        for trial in range(options.trials):
            random = np.random.default_rng([trial, CASES.index(case)])
            detections = draw_detections(case, random, options.shots)
            for name, method in METHODS.items():
                values, sigmas = method(detections)
                errors[name].append((values - true) / FOCAL_PX * 1e4)
                normalised[name].append((values - true) / sigmas)
        for name in METHODS:
            error, over_sigma = np.array(errors[name]), np.array(normalised[name])
            focal = error[:, :2].mean(axis=1)
            print(
                f"{case:8} {name:8} {focal.mean():8.1f} {rms(focal):6.1f} {rms(error[:, 2:]):12.1f}"
                f" {rms(over_sigma[:, :2]):20.2f} {rms(over_sigma[:, 2:]):15.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
