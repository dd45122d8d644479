"""Scatter of a real stereo rig's relative pose between shots, over its reported covariance.

    TRINOC_DATA=... python benchmarks/real_rig.py [--shots N] [--method pixels points] [--corners]

The data are `stereo_circle_plate`: 15 synchronous shots of a plate of 10 x 10 dark circles at
30 mm, back-lit. Each camera's lens comes from all of its pictures; then every shot is calibrated
alone. The two cameras do not move between shots, so that the pose of one before the other is the
same number 15 times, each with its covariance. The aim is free; the lens is taken as exact, or as
uncertain as its calibration says; the plate as exact, or as uncertain as paper. Per method:

z         rms over shots of (relative pose - weighted mean) / claimed sigma, for the three numbers
          of the rotation and the three of the translation
whole     chi-square of all six together over its degrees of freedom; 1 is right
used      cameras whose grey levels were used

With `--corners` instead, of `stereo_chessboard`: each camera alone, by the odd and by the even
shots, with the board's own shape; by how much its corners scatter over what they claim.
"""

import argparse
import os
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

import trinoc
from trinoc.calib.detection.registry import detect_pattern
from trinoc.errors import CalibrationError, DetectionError
from trinoc.numerics.precision import in_float64

CAMERAS = ("left", "right")
PITCH_MM = 30.0
STEP = 1e-5


def pictures(folder: Path, camera: str, shots: int) -> list[np.ndarray]:
    """The first `shots` pictures of one camera, in the order of their names."""
    files = sorted(folder.glob(f"{camera}_*.png"))[:shots]
    return [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]


def plate(radius_mm: float) -> trinoc.Pattern:
    return trinoc.Pattern.circle_grid(rows=10, columns=10, pitch_mm=PITCH_MM, radius_mm=radius_mm)


def measured_radius_mm(image: np.ndarray) -> float:
    """Radius of the circles, from the area of their images relative to that of the lattice."""
    first = plate(PITCH_MM / 4)
    detection = detect_pattern(image, first)
    areas = np.pi * np.sqrt(np.linalg.det(detection.shape_px2))
    homography, _ = cv2.findHomography(
        first.centres_mm[detection.circle_index], detection.centres_px
    )
    ones = np.ones((len(detection.circle_index), 1))
    depth = np.concatenate([first.centres_mm[detection.circle_index], ones], 1) @ homography[2]
    stretch = np.abs(np.linalg.det(homography)) / np.abs(depth) ** 3
    return float(np.median(np.sqrt(areas / stretch / np.pi)))


@in_float64
def relative_pose(rig: trinoc.Rig) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector in degrees and translation in mm of right from left, and their covariance."""
    names = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm", "aim_x_mm", "aim_y_mm")
    rows = [rig.parameters.index(f"{camera}.{name}") for camera in CAMERAS for name in names]
    covariance = np.asarray(rig.covariance)[np.ix_(rows, rows)]
    values = np.array(
        [
            value
            for camera in CAMERAS
            for value in (
                *(getattr(rig[camera], name) for name in names[:4]),
                *rig[camera].aim_mm,
            )
        ]
    )

    def relative(values: np.ndarray) -> np.ndarray:
        matrices = []
        for camera, camera_values in zip(CAMERAS, np.split(values, 2), strict=True):
            lens = rig[camera].intrinsics
            pose = dict(zip(names[:4], camera_values[:4], strict=True))
            matrices.append(
                np.asarray(
                    trinoc.Camera.from_degrees(
                        lens, **pose, aim_mm=camera_values[4:]
                    ).cam_from_world
                )
            )
        turn = matrices[1][:, :3] @ matrices[0][:, :3].T
        shift = matrices[1][:, 3] - turn @ matrices[0][:, 3]
        return np.concatenate([np.degrees(cv2.Rodrigues(turn)[0].ravel()), shift])

    jacobian = np.stack(
        [
            (relative(values + step) - relative(values - step)) / (2 * STEP)
            for step in STEP * np.eye(len(values))
        ],
        axis=1,
    )
    return relative(values), jacobian @ covariance @ jacobian.T


def report(label: str, poses: list[tuple[np.ndarray, np.ndarray]], used: Counter) -> None:
    weights = [np.linalg.inv(covariance) for _, covariance in poses]
    total = np.linalg.inv(np.sum(weights, axis=0))
    mean = total @ np.sum([w @ value for w, (value, _) in zip(weights, poses, strict=True)], axis=0)
    off = np.array([value - mean for value, _ in poses])
    sigma = np.array([np.sqrt(np.diag(covariance)) for _, covariance in poses])
    z = np.sqrt(np.mean((off / sigma) ** 2, axis=0))
    squared = sum(float(o @ w @ o) for o, w in zip(off, weights, strict=True))
    print(
        f"{label:30s} shots {len(poses):2d}  z "
        + " ".join(f"{value:5.2f}" for value in z)
        + f"  whole {squared / (6 * (len(poses) - 1)):6.2f}  scatter "
        + " ".join(f"{value:.4f}" for value in off.std(axis=0))
        + f"  used {dict(used)}"
    )


def corners_over_claims(folder: Path) -> None:
    board = trinoc.Chessboard(rows=6, columns=9, square_mm=1.0)
    for camera in CAMERAS:
        images = [
            cv2.imread(str(f), cv2.IMREAD_GRAYSCALE) for f in sorted(folder.glob(f"{camera}*"))
        ]
        for parity, shots in (("odd", images[::2]), ("even", images[1::2])):
            result = trinoc.calibrate_rig({camera: shots}, board)
            print(
                f"{camera}, {parity} shots: rms {result.rms_px() / np.sqrt(2):.4f} px per axis, "
                f"over claimed sigmas {result.fits[camera].sigma_factor:.2f}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shots", type=int, default=15)
    parser.add_argument("--method", nargs="*", default=["pixels", "points"])
    parser.add_argument("--corners", action="store_true")
    options = parser.parse_args()
    if options.corners:
        corners_over_claims(Path(os.environ["TRINOC_DATA"]) / "stereo_chessboard")
        return
    folder = Path(os.environ["TRINOC_DATA"]) / "stereo_circle_plate"
    images = {camera: pictures(folder, camera, options.shots) for camera in CAMERAS}
    radius_mm = measured_radius_mm(images["left"][0])
    sheet = plate(radius_mm)
    print(f"radius of the circles {radius_mm:.2f} mm")
    lenses, covariances = {}, {}
    for camera, camera_images in images.items():
        result = trinoc.calibrate_intrinsics(camera_images, sheet)
        lenses[camera], covariances[camera] = result.lens, result.covariance
        print(f"{camera}: focal length {np.round(result.values[:2], 2)} px")
    aim = trinoc.Systematics(aim_sigma_mm=1000.0)
    knowledge = {
        "all exact": aim,
        "lens as calibrated": aim._replace(lens_covariance=covariances),
        "plate as paper, too": trinoc.Systematics.typical({})._replace(
            aim_sigma_mm=1000.0, lens_covariance=covariances
        ),
    }
    for label, systematics in knowledge.items():
        for method in options.method:
            poses, used = [], Counter()
            for pair in zip(*images.values(), strict=True):
                try:
                    answer = trinoc.calibrate(
                        dict(zip(CAMERAS, pair, strict=True)),
                        sheet,
                        lenses,
                        method=method,
                        systematics=systematics,
                        orientation="upright",
                    )
                except (CalibrationError, DetectionError) as error:
                    print(f"  {error}")
                    continue
                used.update(fit.method for fit in answer.fits.values())
                poses.append(relative_pose(answer.rig))
            report(f"{label}, {method}", poses, used)


if __name__ == "__main__":
    main()
