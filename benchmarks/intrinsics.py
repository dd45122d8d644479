"""Intrinsics from ten pictures: error over the Cramer-Rao bound, and over the sigmas.

    python benchmarks/intrinsics.py [--sets 4] [--trials 10] [--pictures 10] [--pixels]

A set is a lens and ten poses of the sheet; each of its trials draws new noise. Pictures come
from the ray caster, whose model is independent of the fit's. The bound is that of all grey
levels of all pictures, the poses unknown, blur and grey levels known. Beside trinoc's fit of
centres, with `--pixels` its fit of the grey levels; cv2.calibrateCamera on trinoc's centres, and on
those of cv2.SimpleBlobDetector, with the same five coefficients of distortion.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from simulation.camera_picture.render import render_sheet
from trinoc.calib import Detection, detect_pattern
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.lenses.registry import simplify_lens

SHEET = Pattern.default()
SIZE_PX = (512, 480)
NOISE, BLUR_PX = 2.0, 0.7
# Rounding to whole grey levels adds the variance of its own.
TOTAL_NOISE = np.sqrt(NOISE**2 + 1 / 12)
PAPER, INK = 230.0, 25.0
CONTRAST = PAPER - INK
LINE_POINTS = 400
NAMES = BrownConrady.parameter_names
LENS = np.array([987.65, 1194.03, 250.0, 243.0, -0.2, 0.15, 0.001, -0.0005, -0.05])


def random_poses(seed: int, count: int) -> np.ndarray:
    """Poses (k, 3, 4) of a sheet held by hand, tilted by 10 to 50 degrees to any side."""
    generator = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        tilt, azimuth = np.radians(generator.uniform(10, 50)), generator.uniform(0, 2 * np.pi)
        axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        roll = np.array([0.0, 0.0, generator.uniform(-0.5, 0.5)])
        rotation = cv2.Rodrigues(roll)[0] @ cv2.Rodrigues(tilt * axis)[0] @ np.diag([1.0, -1, -1])
        distance = generator.uniform(380, 560)
        aside = generator.uniform(-0.06, 0.06, 2) * distance
        poses.append(np.column_stack([rotation, np.append(aside, distance)]))
    return np.array(poses)


def image_of(values: np.ndarray, pose: np.ndarray) -> np.ndarray:
    lens = simplify_lens(BrownConrady.from_parameters(values))
    camera = Camera(Intrinsics.of_lens(lens, SIZE_PX), Pose(pose))
    return render_sheet(SHEET, camera, paper=PAPER, ink=INK, blur_px=BLUR_PX, bits=None)


def bound(poses: np.ndarray) -> np.ndarray:
    """Standard deviations of the lens's parameters by the Cramer-Rao bound of the grey levels.

    An edge that moves along its normal by e changes the grey levels by e^2 contrast^2 /
    (2 sqrt(pi) spread noise^2) of information per pixel of its length. Differences of rendered
    pictures would not do: their sampling noise passes for information on what is hardly known.
    """
    spread = np.sqrt(BLUR_PX**2 + 1 / 12)
    density = CONTRAST**2 / (2 * np.sqrt(np.pi) * spread * TOTAL_NOISE**2)
    information = np.zeros((9, 9))
    for pose in poses:
        full = np.zeros((15, 15))
        for curve_mm, normal_mm in edges_mm():
            uv_px, shift_px = imaged(curve_mm, pose)
            aside_px = imaged(curve_mm + 1e-3 * normal_mm, pose)[0] - uv_px
            tangent = np.gradient(uv_px, axis=0)
            length = np.linalg.norm(tangent, axis=1)
            across = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / length[:, None]
            inside = ((uv_px > 0) & (uv_px < np.array(SIZE_PX) - 1)).all(axis=1)
            weight = density * length * inside
            if len(curve_mm) == LINE_POINTS:
                # The two edges of a line share pixels: they move together and partly cancel.
                width = np.abs(np.sum(aside_px * across, axis=1)) * 1e3 * SHEET.line_width_mm
                weight = weight * (1 - np.exp(-(width**2) / (4 * spread**2)))
            normal_shift = np.einsum("ni,nip->np", across, shift_px)
            full += normal_shift.T @ (weight[:, None] * normal_shift)
        information += full[:9, :9] - full[:9, 9:] @ np.linalg.solve(full[9:, 9:], full[9:, :9])
    return np.sqrt(np.diag(np.linalg.inv(information)))


def edges_mm() -> list[tuple[np.ndarray, np.ndarray]]:
    """All edges of ink on the sheet as curves (n, 2) with unit normals."""
    angle = np.linspace(0, 2 * np.pi, 121)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edges = []
    for centre, outer, inner in zip(
        SHEET.centres_mm, SHEET.radius_mm, SHEET.inner_radius_mm, strict=True
    ):
        edges += [(centre + radius * ring, ring) for radius in (outer, inner) if radius > 0]
    for axis, half in enumerate(SHEET.line_half_length_mm):
        for side in (-0.5, 0.5):
            normal = np.zeros((LINE_POINTS, 2))
            normal[:, 1 - axis] = 1.0
            line = side * SHEET.line_width_mm * normal
            line[:, axis] = np.linspace(-half, half, LINE_POINTS)
            edges.append((line, normal))
    return edges


def imaged(points_mm: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n, 2) of points of the sheet, and their derivatives (n, 2, 15)."""
    matrix = np.array([[LENS[0], 0, LENS[2]], [0, LENS[1], LENS[3]], [0, 0, 1]])
    points = np.pad(points_mm, ((0, 0), (0, 1)))
    uv, jacobian = cv2.projectPoints(
        points, cv2.Rodrigues(pose[:, :3])[0], pose[:, 3], matrix, LENS[4:]
    )
    motion, lens = jacobian[:, :6], jacobian[:, 6:15]
    return uv.reshape(-1, 2), np.concatenate([lens, motion], axis=1).reshape(-1, 2, 15)


def opencv_lens(detections: list[Detection], centres: list[np.ndarray]) -> np.ndarray:
    """The lens's parameters by cv2.calibrateCamera; rows of `centres` that are NaN are left out."""
    sheet, picture = [], []
    for detection, uv in zip(detections, centres, strict=True):
        is_valid = np.isfinite(uv).all(axis=1)
        points = np.pad(SHEET.centres_mm[detection.circle_index[is_valid]], ((0, 0), (0, 1)))
        sheet.append(points.astype(np.float32))
        picture.append(uv[is_valid].astype(np.float32))
    _, matrix, distortion, *_ = cv2.calibrateCamera(sheet, picture, SIZE_PX, None, None)
    focal_and_centre = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    return np.concatenate([focal_and_centre, distortion.reshape(-1)[:5]])


def blob_centres(image: np.ndarray, detection: Detection) -> np.ndarray:
    """Centre of the blob at each circle by a tuned cv2.SimpleBlobDetector; NaN for rings.

    On the picture enlarged four times, where its centres are fifteen times better than on the
    picture itself.
    """
    factor = 4
    settings = cv2.SimpleBlobDetector_Params()
    settings.minArea, settings.maxArea = 30 * factor**2, 20000 * factor**2
    settings.thresholdStep, settings.minThreshold, settings.maxThreshold = 5, 60, 200
    settings.filterByInertia, settings.minConvexity = False, 0.95
    detector = cv2.SimpleBlobDetector_create(settings)
    large = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    blobs = (np.array([blob.pt for blob in detector.detect(large)]) - (factor - 1) / 2) / factor
    distance = np.linalg.norm(detection.centres_px[:, None] - blobs[None], axis=2)
    nearest = blobs[distance.argmin(axis=1)]
    return np.where(distance.min(axis=1)[:, None] < 2.0, nearest, np.nan)


def timed(function: Callable[[], Any], times: list[float]) -> Any:
    start = time.perf_counter()
    answer = function()
    times.append(time.perf_counter() - start)
    return answer


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--sets", type=int, default=4)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--pictures", type=int, default=10)
    parser.add_argument("--first-set", type=int, default=0)
    parser.add_argument("--pixels", action="store_true")
    options = parser.parse_args()
    ours = ["trinoc", "trinoc, distortion=4", *(["trinoc, pixels"] if options.pixels else [])]
    names = [*ours, "cv2, trinoc's centres", "cv2, blobs"]
    errors: dict[str, list[np.ndarray]] = {name: [] for name in names}
    normalised: dict[str, list[np.ndarray]] = {name: [] for name in ours}
    times: dict[str, list[float]] = {name: [] for name in names}
    for number in range(options.first_set, options.first_set + options.sets):
        poses = random_poses(number, options.pictures)
        crb = bound(poses)
        clean = [image_of(LENS, pose) for pose in poses]
        for trial in range(options.trials):
            generator = np.random.default_rng([number, trial])
            images = [
                np.rint(np.clip(c + generator.normal(0, NOISE, c.shape), 0, 255)).astype(np.uint8)
                for c in clean
            ]
            detections = [detect_pattern(image, SHEET) for image in images]
            centres = [detection.centres_px for detection in detections]
            blobs = [blob_centres(i, d) for i, d in zip(images, detections, strict=True)]
            chains: list[Callable[[], Any]] = [
                lambda d=detections: calibrate_intrinsics(d, SHEET),
                lambda d=detections: calibrate_intrinsics(d, SHEET, distortion=4),
                lambda i=images: calibrate_intrinsics(i, SHEET, method="pixels"),
            ]
            results = [timed(chain, times[name]) for name, chain in zip(ours, chains, strict=False)]
            answers = dict(zip(ours, [result.values for result in results], strict=True))
            for name, uv_px in zip(names[len(ours) :], (centres, blobs), strict=True):
                answers[name] = timed(
                    lambda d=detections, uv=uv_px: opencv_lens(d, uv), times[name]
                )
            for name, values in answers.items():
                errors[name].append((values - LENS) / crb)
            for name, result in zip(ours, results, strict=True):
                sigma = np.sqrt(np.diag(result.covariance))
                sigma = np.where(sigma > 0, sigma, np.nan)
                normalised[name].append((result.values - LENS) / sigma)
        print(
            f"set {number}: bound",
            dict(zip(NAMES, crb.round(6), strict=True)),
        )
    count = options.sets * options.trials
    print(f"\n{count} trials of {options.pictures} pictures; rms error / Cramer-Rao bound")
    print(f"{'':26}" + "".join(f"{name:>8}" for name in NAMES) + "     rms  ms")
    for name in names:
        ratio = np.sqrt(np.mean(np.square(errors[name]), axis=0))
        cells = "".join(f"{value:8.2f}" for value in ratio)
        total = np.sqrt(np.mean(ratio**2))
        print(f"{name:26}{cells}{total:8.2f}{1e3 * np.median(times[name]):5.0f}")
    print("rms error / claimed sigma (a coefficient left out has none)")
    for name in ours:
        scores = np.array(normalised[name])
        has_sigma = np.isfinite(scores)
        total = np.sqrt(np.nansum(scores**2, axis=0) / np.maximum(has_sigma.sum(axis=0), 1))
        cells = "".join(f"{v:8.2f}" if n else f"{'-':>8}" for v, n in zip(total, has_sigma.sum(0)))
        print(f"{name:26}{cells}{np.sqrt(np.nanmean(scores**2)):8.2f}")


if __name__ == "__main__":
    main()
