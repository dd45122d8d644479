"""A rig and its lenses from many shots: errors over the bound and over the reported sigmas.

Three cameras with unknown lenses of four coefficients, and what a detector with the stated
noise reports of a chessboard (corners) and of our sheet (circles, by the exact centres of their
images). The bound is the covariance of the least squares at the stated noise. Beside trinoc, on the
same observations: cv2.calibrateCamera for each camera and then cv2.stereoCalibrate with the first,
lenses held and lenses free; cv2.calibrateMultiview; and, of the chessboard and where it is
installed, mrcal, with its own outlier rejection and regularisation, for a flat board. OpenCV takes
the centre of a circle's image for the image of its centre.
"""

import shutil
import time
from functools import partial

import cv2
import jax
import numpy as np

from rig_parts.mrcal import PROGRAM, calibrate_by_mrcal
from trinoc.calib import Detection
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry import Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.polynomial import BrownConrady

SIZE_PX, METRE_MM = (640, 480), 1000.0
LENSES = {
    "left": (800.0, 805.0, 322.0, 236.0, -0.20, 0.06, 0.001, -0.0005, 0.0),
    "middle": (780.0, 782.0, 315.0, 243.0, -0.15, 0.03, 0.0, 0.001, 0.0),
    "right": (820.0, 818.0, 326.0, 240.0, -0.18, 0.05, -0.001, 0.0, 0.0),
}
PLACES = {"left": (-0.35, -220.0), "middle": (0.0, 0.0), "right": (0.35, 220.0)}
BOARDS: dict[str, tuple[AbstractTarget, float]] = {
    "chessboard": (Chessboard(rows=8, columns=8, square_mm=20.0), 0.1),
    "sheet": (Pattern.default(), 0.02),
}
POSE = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "centre_x_mm", "centre_y_mm", "centre_z_mm")


def rotation(vector) -> np.ndarray:
    return cv2.Rodrigues(np.asarray(vector, dtype=float))[0]


def cam_from_rig(name: str) -> np.ndarray:
    angle, x = PLACES[name]
    turn = rotation([0, angle, 0])
    return np.column_stack([turn, -turn @ [x, 0, 0]])


def boards(count: int, random: np.random.Generator) -> list[np.ndarray]:
    poses = []
    for _ in range(count):
        about, tilt = random.uniform(0, 2 * np.pi), np.radians(random.uniform(15, 45))
        turn = rotation([tilt * np.cos(about), tilt * np.sin(about), 0])
        turn = turn @ rotation([0, 0, random.uniform(-0.4, 0.4)]) @ np.diag([1.0, -1, -1])
        position_mm = [*random.uniform(-60, 60, 2), random.uniform(480, 650)]
        poses.append(np.column_stack([turn, position_mm]))
    return poses


@jax.jit
def seen(lens, pose, centres, radius):
    camera = Camera(Intrinsics.of_lens(lens, SIZE_PX), Pose(pose))
    corner = jax.vmap(lambda p: lens.project_ray(pose[:, :2] @ p + pose[:, 3]))(centres)
    safe = jax.numpy.where(radius > 0, radius, 1.0)
    circle = jax.vmap(image_of_circle_centre, (None, 0, 0))(camera, centres, safe)
    return jax.numpy.where(radius[:, None] > 0, circle, corner)


def observed(target, sigma_px, poses, random) -> dict[str, list[Detection | None]]:
    detections: dict[str, list[Detection | None]] = {}
    for name, values in LENSES.items():
        lens, camera_pose, detections[name] = (
            BrownConrady.from_parameters(np.array(values)),
            cam_from_rig(name),
            [],
        )
        for pose in poses:
            both = np.column_stack(
                [
                    camera_pose[:, :3] @ pose[:, :3],
                    camera_pose[:, :3] @ pose[:, 3] + camera_pose[:, 3],
                ]
            )
            with jax.enable_x64(True):
                exact = np.asarray(seen(lens, both, target.centres_mm, target.radius_mm))
            inside = ((exact > 5) & (exact < np.array(SIZE_PX) - 6)).all(axis=1)
            count = int(inside.sum())
            detections[name].append(
                Detection(
                    circle_index=np.flatnonzero(inside),
                    centres_px=exact[inside] + random.normal(0, sigma_px, (count, 2)),
                    covariance_px2=np.tile(sigma_px**2 * np.eye(2), (count, 1, 1)),
                    shape_px2=np.full((count, 2, 2), np.nan),
                    lines_px=np.full((2, 3), np.nan),
                    image_size_px=SIZE_PX,
                )
                if count >= 20
                else None
            )
    return detections


def truth() -> dict[str, float]:
    values = {
        f"{name}.{key}": value
        for name, lens_values in LENSES.items()
        for key, value in zip(BrownConrady.parameter_names, lens_values, strict=True)
    }
    first = cam_from_rig("left")
    for name in LENSES:
        values |= pose_numbers(name, relative(first, cam_from_rig(name)))
    return values


def relative(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    turn = second[:, :3] @ first[:, :3].T
    return np.column_stack([turn, second[:, 3] - turn @ first[:, 3]])


def pose_numbers(name: str, pose: np.ndarray) -> dict[str, float]:
    """Rotation vector from the true rotation, and the centre, in the first camera's frame."""
    true = relative(cam_from_rig("left"), cam_from_rig(name))
    turn = np.degrees(cv2.Rodrigues(pose[:, :3] @ true[:, :3].T)[0].ravel())
    numbers = [*turn, *(-pose[:, :3].T @ pose[:, 3])]
    return dict(zip([f"{name}.{key}" for key in POSE], numbers, strict=True))


def by_trinoc(target, detections):
    result = calibrate_rig(
        detections, target, world="left", systematics=Systematics(), distortion=4
    )
    values = dict(zip(result.parameters, result.values, strict=True))
    sigmas = {name: result.sigma(name) for name in result.parameters}
    factors = {camera: fit.sigma_factor for camera, fit in result.fits.items()}
    bound = {n: s / factors.get(n.split(".")[0], 1.0) for n, s in sigmas.items()}
    for name in LENSES:
        values |= pose_numbers(name, np.asarray(result.rig[name].cam_from_world))
    return values, sigmas, bound, result.halves


def points(target, detection):
    index = detection.circle_index
    board_points = np.pad(target.centres_mm[index], ((0, 0), (0, 1))).astype(np.float32)
    return board_points[:, None], detection.centres_px.astype(np.float32)[:, None]


def by_opencv(target, detections, *, free: bool) -> dict[str, float]:
    values, lenses = {}, {}
    for name, camera_detections in detections.items():
        pairs = [
            points(target, detection) for detection in camera_detections if detection is not None
        ]
        start = np.array([[800.0, 0, 319.5], [0, 800.0, 239.5], [0, 0, 1]])
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
        _, matrix, distortion, _, _ = cv2.calibrateCamera(
            [p for p, _ in pairs], [q for _, q in pairs], SIZE_PX, start, np.zeros(5), flags=flags
        )
        lenses[name] = matrix, distortion.ravel()[:5]
    for name in list(detections)[1:]:
        shared = [
            (a, b) for a, b in zip(detections["left"], detections[name], strict=True) if a and b
        ]
        board_points, first_px, second_px = [], [], []
        for a, b in shared:
            both, in_a, in_b = np.intersect1d(a.circle_index, b.circle_index, return_indices=True)
            board_points.append(
                np.pad(target.centres_mm[both], ((0, 0), (0, 1))).astype(np.float32)
            )
            first_px.append(a.centres_px[in_a].astype(np.float32))
            second_px.append(b.centres_px[in_b].astype(np.float32))
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
        flags = flags if free else cv2.CALIB_FIX_INTRINSIC
        (m1, d1), (m2, d2) = lenses["left"], lenses[name]
        _, m1, d1, m2, d2, turn, shift, *_ = cv2.stereoCalibrate(
            board_points, first_px, second_px, m1.copy(), d1.copy(), m2.copy(), d2.copy(), SIZE_PX,
            flags=flags,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9),
        )  # fmt: skip
        if free:
            lenses["left"] = m1, np.ravel(d1)[:5]
            lenses[name] = m2, np.ravel(d2)[:5]
        values |= pose_numbers(name, np.column_stack([turn, np.ravel(shift)]))
    for name, (matrix, distortion) in lenses.items():
        parameters = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion]
        keys = [f"{name}.{key}" for key in BrownConrady.parameter_names]
        values |= dict(zip(keys, parameters, strict=True))
    return values


def by_multiview(target, detections) -> dict[str, float]:
    """OpenCV 5's joint estimate, in metres: in millimetres it treats every board as a line."""
    everything = np.pad(target.centres_mm / METRE_MM, ((0, 0), (0, 1))).astype(np.float32)
    shots = len(detections["left"])
    image, mask = [], np.zeros((len(detections), shots), np.uint8)
    for c, camera_detections in enumerate(detections.values()):
        rows = []
        for s, detection in enumerate(camera_detections):
            pixels = np.full((len(everything), 2), -1.0, np.float32)
            if detection is not None:
                pixels[detection.circle_index] = detection.centres_px
                mask[c, s] = 1
            rows.append(pixels)
        image.append(rows)
    out = cv2.calibrateMultiview(
        [everything] * shots, image, [SIZE_PX] * len(detections), mask,
        np.zeros(len(detections), np.uint8), None, None, None, None,
    )  # fmt: skip
    _, matrices, distortions, turns, shifts = out[:5]
    values = {}
    poses = [
        np.column_stack(
            [rotation(turn) if np.size(turn) == 3 else turn, METRE_MM * np.ravel(shift)]
        )
        for turn, shift in zip(turns, shifts, strict=True)
    ]
    for k, name in enumerate(detections):
        linear = [matrices[k][0, 0], matrices[k][1, 1], matrices[k][0, 2], matrices[k][1, 2]]
        keys = [f"{name}.{key}" for key in BrownConrady.parameter_names]
        values |= dict(zip(keys, [*linear, *np.ravel(distortions[k])[:5]], strict=True))
        values |= pose_numbers(name, relative(poses[0], poses[k]))
    return values


def by_mrcal(target, detections) -> dict[str, float]:
    models, _ = calibrate_by_mrcal(target, detections, SIZE_PX, 4, ["--skip-calobject-warp-solve"])
    poses = {
        name: np.column_stack([rotation(model["extrinsics"][:3]), model["extrinsics"][3:]])
        for name, model in models.items()
    }
    values = {}
    for name, model in models.items():
        parameters = [*model["intrinsics"], 0.0][:9]
        keys = [f"{name}.{key}" for key in BrownConrady.parameter_names]
        values |= dict(zip(keys, parameters, strict=True))
        values |= pose_numbers(name, relative(poses["left"], poses[name]))
    return values


def run(trials: int, shots: int) -> None:
    """Print a table for each board."""
    if shutil.which(PROGRAM) is None:
        print(f"{PROGRAM} is not installed (Debian: apt-get install mrcal): it is left out.")
    true = truth()
    lens_keys = [k for k in true if k.split(".")[1] in BrownConrady.parameter_names[:8]]
    pose_keys = [k for k in true if k.split(".")[1] in POSE and not k.startswith("left.")]
    for title, (target, sigma_px) in BOARDS.items():
        errors: dict[str, list] = {}
        normalised, halves, seconds = [], [], []
        for trial in range(trials):
            random = np.random.default_rng(trial)
            detections = observed(target, sigma_px, boards(shots, random), random)
            start = time.perf_counter()
            values, sigmas, bound, check = by_trinoc(target, detections)
            seconds.append(time.perf_counter() - start)
            halves.append(np.nan if check is None else check.ratio)
            normalised.append([(values[k] - true[k]) / sigmas[k] for k in (*lens_keys, *pose_keys)])
            chains = {
                "trinoc": lambda target, detections, estimates=values: estimates,
                "cv2 calibrateCamera + stereoCalibrate": partial(by_opencv, free=False),
                "cv2 the same, lenses free in stereo": partial(by_opencv, free=True),
                "cv2.calibrateMultiview": by_multiview,
            }
            if shutil.which(PROGRAM) is not None and isinstance(target, Chessboard):
                chains["mrcal"] = by_mrcal
            for chain, estimate in chains.items():
                try:
                    estimates = estimate(target, detections)
                except cv2.error as error:
                    print(f"  {chain} fails: {str(error).split('(-')[-1][:160]}")
                    continue
                row = [(estimates[k] - true[k]) / bound[k] for k in (*lens_keys, *pose_keys)]
                errors.setdefault(chain, []).append(row)
        count = len(lens_keys)
        print(f"\n{title}, {sigma_px} px, 3 cameras, {shots} shots, {trials} trials")
        print("error over the bound (rms)                     lenses   poses")
        for chain, rows in errors.items():
            table = np.array(rows)
            print(f"  {chain:42} {rms(table[:, :count]):9.2f} {rms(table[:, count:]):7.2f}")
        table = np.array(normalised)
        print(f"  error over claimed sigma                   {rms(table[:, :count]):9.2f} "
              f"{rms(table[:, count:]):7.2f}")  # fmt: skip
        print(f"  halves over claimed sigmas: {np.nanmean(halves):.2f}; "
              f"{np.median(seconds):.1f} s a rig (median)", flush=True)  # fmt: skip


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
