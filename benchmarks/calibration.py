"""Calibration from one picture: error over the Cramer-Rao bound, coverage, time.

    python benchmarks/calibration.py [--poses N] [--seeds K] [--wide] [--supersampling S]

The reference scene: 5 x 5 circles of 6 mm radius at 20 mm and a cross of 1 mm lines that stop
1.5 mm before a circle; ink 25, paper 230, blur 0.7 px, noise 2 grey levels, 512 x 480 px of 8
bits. Poses scatter about the paper's Table 1, or with --wide over pan +-60, tilt 20 to 80
degrees. Each pose is ray cast once by `simulation`, which knows nothing of the fitted model,
and noise is added K times. The bound is that of the whole picture, at the true noise.

The same pictures go to OpenCV's blob detector (tuned) with solvePnP, to
scipy.optimize.least_squares on our circles with our residual, and to pycolmap where it is
installed. Blobs get their labels from the truth. Times are medians of warm calls.
"""

import argparse
import time
from collections.abc import Callable
from typing import NamedTuple

import cv2
import jax
import numpy as np
from scipy.optimize import least_squares

from simulation.camera_picture.render import render_sheet
from trinoc.calib import (
    CalibrationResult,
    Detection,
    calibrate_detections,
    detect_pattern,
)
from trinoc.calib.adjustment.single_camera import fit_single_camera
from trinoc.calib.photometric.image_fit import refine_image
from trinoc.calib.photometric.views import refine_views
from trinoc.calib.problem.sheet_problem import SheetPriors
from trinoc.calib.result.degrees import pose_of_values
from trinoc.calib.sheet_calibration import calibrate_sheet
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import DetectionError
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.pose import PoseModel
from trinoc.synth import table1_lens

LENS, NOISE = table1_lens(), 2.0
TABLE_1 = np.array(
    [
        [2.143, 53.252, -1.714, 476.369],
        [23.568, 38.616, -0.994, 472.894],
        [-23.241, 38.264, 0.872, 474.471],
    ]
)
SHEET = Pattern.cross_grid(rows=5, columns=5, pitch_mm=20.0, radius_mm=6.0, rings="none")
SHEET_MM = np.concatenate([SHEET.centres_mm, np.zeros((len(SHEET), 1))], axis=1)
# The least that rounding to whole grey levels adds to the noise.
TRUE_NOISE = float(np.hypot(NOISE, np.sqrt(1 / 12)))


class Trial(NamedTuple):
    """One picture: errors of (pan, tilt, swing in degrees, distance in mm) by method."""

    errors: dict[str, np.ndarray]
    sigmas: dict[str, np.ndarray]
    bound: np.ndarray


def poses(count: int, wide: bool, seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    if wide:
        low, high = [-60.0, 20.0, -20.0, 440.0], [60.0, 80.0, 20.0, 540.0]
        return generator.uniform(low, high, (count, 4))
    spread = generator.uniform(-1.0, 1.0, (count, 4)) * [5.0, 5.0, 5.0, 15.0]
    return TABLE_1[np.arange(count) % 3] + spread


def camera_of(values: np.ndarray) -> Camera:
    names = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
    return Camera.from_degrees(LENS, **dict(zip(names, map(float, values), strict=True)))


def blob_centres(picture: np.ndarray, true_px: np.ndarray) -> np.ndarray | None:
    settings = cv2.SimpleBlobDetector.Params()
    settings.filterByArea, settings.minArea, settings.maxArea = True, 30, 5000
    settings.filterByConvexity = settings.filterByInertia = settings.filterByCircularity = False
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = 40, 215, 5
    points = cv2.SimpleBlobDetector.create(settings).detect(picture)
    centres = np.array([point.pt for point in points]).reshape(-1, 2)
    if len(centres) < len(true_px):
        return None
    distance = np.linalg.norm(centres[None] - true_px[:, None], axis=2)
    nearest = distance.argmin(axis=1)
    return centres[nearest] if distance.min(axis=1).max() < 3 else None


def values_of(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    matrix = np.asarray(LENS.matrix) @ np.column_stack([rotation, translation])
    camera = Camera.from_matrix(matrix, LENS.image_size_px)
    return np.array([camera.pan_deg, camera.tilt_deg, camera.swing_deg, camera.distance_mm])


def by_solve_pnp(centres: np.ndarray) -> np.ndarray:
    _, vector, translation = cv2.solvePnP(SHEET_MM, centres, np.asarray(LENS.matrix), None)
    return values_of(cv2.Rodrigues(vector)[0], translation[:, 0])


def by_pycolmap(centres: np.ndarray) -> np.ndarray | None:
    try:
        import pycolmap
    except ImportError:
        return None
    width, height = LENS.image_size_px
    (fu, fv), (cu, cv) = LENS.focal_length_px, LENS.principal_point_px
    # COLMAP puts the centre of the first pixel at (0.5, 0.5).
    camera = pycolmap.Camera(
        model="PINHOLE", width=width, height=height, params=[fu, fv, cu + 0.5, cv + 0.5]
    )
    answer = pycolmap.estimate_and_refine_absolute_pose(centres + 0.5, SHEET_MM, camera)
    if answer is None:
        return None
    motion = answer["cam_from_world"].matrix()
    return values_of(motion[:, :3], motion[:, 3])


def by_scipy(detection: Detection, start: np.ndarray) -> np.ndarray:
    pose = pose_of_values(np.append(start, [0.0, 0.0]))
    sigma_px = np.sqrt(np.einsum("nii->ni", detection.covariance_px2))
    index = detection.circle_index
    circles = SHEET.centres_mm[index], SHEET.radius_mm[index], detection.centres_px, sigma_px
    answer = least_squares(
        lambda step: np.asarray(_scipy_residual(pose, circles, step)).ravel(), np.zeros(4)
    )
    end = pose.retract(answer.x, PoseModel.AIMED, pose.distance_mm)
    return values_of(np.asarray(end.rotation), np.asarray(end.translation_mm))


@jax.jit
def _scipy_residual(pose, circles, step):
    end = Camera(LENS, pose.retract(step, PoseModel.AIMED, pose.distance_mm))
    centres_mm, radius_mm, seen_px, sigma_px = circles
    predicted = jax.vmap(image_of_circle_centre, (None, 0, 0))(end, centres_mm, radius_mm)
    return (predicted - seen_px) / sigma_px


def labelled(detection: Detection, true_px: np.ndarray) -> Detection:
    """The true labelling among those that a plain grid leaves ambiguous."""
    choices = [detection.circle_index]
    if detection.ambiguity is not None:
        choices.extend(detection.ambiguity)
    errors = [np.abs(true_px[c] - detection.centres_px).max() for c in choices]
    best = choices[int(np.argmin(errors))]
    return Detection(
        np.asarray(best),
        detection.centres_px,
        detection.covariance_px2,
        detection.shape_px2,
        np.full((2, 3), np.nan) if best is not detection.circle_index else detection.lines_px,
        detection.image_size_px,
    )


def difference(values: np.ndarray, truth: np.ndarray) -> np.ndarray:
    error = values - truth
    error[[0, 2]] = (error[[0, 2]] + 180) % 360 - 180
    return error


def by_picture(
    picture: np.ndarray, detection: Detection, pattern: Pattern, model: PoseModel
) -> CalibrationResult:
    """Calibration by the grey levels; all other inputs are exact."""
    priors, images = SheetPriors(model, Systematics()), {"a": picture.astype(np.float32)}
    return calibrate_sheet({"a": detection}, pattern, {"a": LENS}, priors, None, images=images)


def one_trial(picture: np.ndarray, truth: np.ndarray, true_px: np.ndarray) -> Trial | None:
    try:
        detection = labelled(detect_pattern(picture, SHEET), true_px)
    except DetectionError:
        return None
    names = {"a": detection}
    circles = calibrate_detections(names, SHEET, LENS, systematics=Systematics())
    refined = by_picture(picture, detection, SHEET, PoseModel.AIMED)
    quality = refined.fits["a"].image
    if quality is None:
        return None
    covariance = refined.covariance
    bound = np.sqrt(np.diag(covariance)) * TRUE_NOISE / quality.noise
    errors = {
        "trinoc, picture": difference(refined.values.copy(), truth),
        "trinoc, circles": difference(circles.values.copy(), truth),
        "our circles + scipy": difference(by_scipy(detection, truth + 0.05), truth),
    }
    sigmas = {
        "trinoc, picture": np.sqrt(np.diag(covariance)),
        "trinoc, circles": np.sqrt(np.diag(circles.covariance)),
    }
    centres = blob_centres(picture, true_px)
    if centres is not None:
        errors["blob + solvePnP"] = difference(by_solve_pnp(centres), truth)
        other = by_pycolmap(centres)
        if other is not None:
            errors["blob + pycolmap"] = difference(other, truth)
    return Trial(errors, sigmas, bound)


def report_accuracy(trials: list[Trial]) -> None:
    print(f"{'error / bound, rms':24s} {'pictures':>8s}    pan   tilt  swing   dist    all")
    for method in {name: None for trial in trials for name in trial.errors}:
        ratios = np.array([t.errors[method] / t.bound for t in trials if method in t.errors])
        row = np.sqrt(np.mean(ratios**2, axis=0))
        cells = " ".join(f"{value:6.3f}" for value in (*row, np.sqrt(np.mean(ratios**2))))
        print(f"{method:24s} {len(ratios):8d} {cells}")
    print("error / claimed sigma, rms, and share within 1.96 sigma")
    for method in ("trinoc, picture", "trinoc, circles"):
        ratios = np.array([t.errors[method] / t.sigmas[method] for t in trials])
        row = np.sqrt(np.mean(ratios**2, axis=0))
        inside = np.mean(np.abs(ratios) < 1.96)
        cells = " ".join(f"{value:6.3f}" for value in row)
        print(f"{method:24s} {len(ratios):8d} {cells}   {100 * inside:.1f} %")


def milliseconds(call: Callable[[], object], repeats: int = 60) -> float:
    call()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(call())
        taken.append(time.perf_counter() - start)
    return 1e3 * float(np.median(taken))


def report_times(picture: np.ndarray, truth: np.ndarray, true_px: np.ndarray) -> None:
    detection = labelled(detect_pattern(picture, SHEET), true_px)
    centres, grey = detection.centres_px, picture.astype(np.float32)
    start, aimed = pose_of_values(np.append(truth + 0.01, [0, 0])), PoseModel.AIMED
    greys, starts = dict.fromkeys("abc", grey), dict.fromkeys("abc", start)
    three_lenses = dict.fromkeys("abc", LENS.lens)
    calls: dict[str, tuple[Callable[[], object], int]] = {
        "cv2.solvePnP": (lambda: by_solve_pnp_alone(centres), 1),
        "scipy least_squares": (lambda: by_scipy(detection, truth + 0.05), 1),
        "circle fit": (lambda: fit_single_camera(detection, SHEET, LENS, aimed), 1),
        "detect_pattern": (lambda: detect_pattern(picture, SHEET), 1),
        "refinement": (lambda: refine_image(grey, SHEET, LENS.lens, start, aimed), 1),
        "refinement, three": (
            lambda: refine_views(greys, starts, SHEET, three_lenses, aimed, {}),
            1,
        ),
    }
    print("ms, median of warm calls")
    for name, (call, share) in calls.items():
        print(f"{name:24s} {milliseconds(call, 60 if share == 1 else 5) / share:9.4f}")


def by_solve_pnp_alone(centres: np.ndarray) -> object:
    return cv2.solvePnP(SHEET_MM, centres, np.asarray(MATRIX), None)


MATRIX = np.array(
    [
        [LENS.focal_length_px[0], 0.0, LENS.principal_point_px[0]],
        [0.0, LENS.focal_length_px[1], LENS.principal_point_px[1]],
        [0.0, 0.0, 1.0],
    ]
)


def main() -> None:
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--poses", type=int, default=100)
    arguments.add_argument("--seeds", type=int, default=4)
    arguments.add_argument("--wide", action="store_true")
    arguments.add_argument("--supersampling", type=int, default=64)
    options = arguments.parse_args()
    trials, missed, picture = [], 0, None
    truths = poses(options.poses, options.wide)
    with jax.enable_x64(True):
        for k, truth in enumerate(truths):
            camera = camera_of(truth)
            homogeneous = np.column_stack([SHEET_MM, np.ones(len(SHEET))]) @ camera.matrix_px.T
            true_px = homogeneous[:, :2] / homogeneous[:, 2:]
            exact = render_sheet(SHEET, camera, supersampling=options.supersampling, bits=None)
            for seed in range(options.seeds):
                noise = np.random.default_rng(1000 * k + seed).normal(0.0, NOISE, exact.shape)
                picture = np.rint(np.clip(exact + noise, 0, 255)).astype(np.uint8)
                trial = one_trial(picture, truth, true_px)
                missed += trial is None
                if trial is not None:
                    trials.append(trial)
        kind = "pan +-60, tilt 20-80" if options.wide else "about Table 1"
        print(f"{len(trials)} pictures, {kind}; {missed} without an answer")
        report_accuracy(trials)
        assert picture is not None
        report_times(picture, truths[-1], true_px)


if __name__ == "__main__":
    main()
