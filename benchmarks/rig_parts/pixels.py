"""A rig and its lenses from the grey levels of many shots: errors over the bound of the pixels.

The rig of `made.py`: three cameras with unknown lenses of four coefficients, ten shots
of our sheet, or of a chessboard, a ChArUco board or an AprilGrid of about its size, rendered by
rays (640 x 480 px, ink 25, paper 230, blur .7 px, noise 2 grey levels, rounded); or
three fisheyes of 260 px, 60 mm apart, which see the board up to 60 degrees off their axes. The
bound is Cramer and Rao's, of all pixels of the pictures in which the board is found, with light,
ink and blur of each picture unknown: a picture's change by every parameter is its gradient along
the motion of what it shows. Beside
`method="pixels"`: `method="points"`, and on the same detected places cv2.calibrateCamera, then
cv2.stereoCalibrate with lenses free (of fisheyes cv2.fisheye.calibrate, then
cv2.fisheye.stereoCalibrate with lenses held).
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from rig_parts.made import (
    LENSES,
    PLACES,
    POSE,
    SIZE_PX,
    boards,
    by_opencv,
    points,
    relative,
    rms,
    rotation,
)
from simulation.camera_picture.layers import Paint
from simulation.camera_picture.render import render_sheet
from simulation.camera_picture.shapes import Cells
from trinoc.calib import detect_target
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import square_sheet
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, DetectionError
from trinoc.geometry import AbstractLens, Pose
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.rotation import rotation_from_vector

BOARDS = {
    "sheet": Pattern.default(),
    "chessboard": Chessboard(rows=8, columns=8, square_mm=20.0),
    "charuco": Charuco(rows=8, columns=8, square_mm=20.0, marker_mm=15.0),
    "aprilgrid": AprilGrid(rows=4, columns=4, tag_mm=32.0),
}
PAPER, INK, BLUR_PX, NOISE = 230.0, 25.0, 0.7, 2.0
VARIANCE = NOISE**2 + 1 / 12
SHOTS, HEAD = 10, 14 * 3
# Numbers of a lens that are found: k3 of the first is held.
FOUND = 8
# Ink of boards of squares is painted over a sheet that has none.
BARE: Any = SimpleNamespace(
    centres_mm=np.zeros((0, 2)), radius_mm=np.zeros(0), inner_radius_mm=np.zeros(0),
    line_width_mm=0.0, line_half_length_mm=(0.0, 0.0), line_style="stop", line_gap_mm=0.0,
)  # fmt: skip


class Setup(NamedTuple):
    """Lenses, and cameras' angle about Y and position along X, by camera; random board poses."""

    model: type[AbstractLens]
    lenses: dict[str, tuple[float, ...]]
    angle_and_x: dict[str, tuple[float, float]]
    boards: Callable[[int, np.random.Generator], list[np.ndarray]]

    def lens(self, name) -> AbstractLens:
        return self.model.from_parameters(np.array(self.lenses[name]))

    def cam_from_rig(self, name) -> np.ndarray:
        angle, x = self.angle_and_x[name]
        turn = rotation([0, angle, 0])
        return np.column_stack([turn, -turn @ [x, 0, 0]])

    def cam_from_board(self, name, pose) -> np.ndarray:
        cam_from_rig = self.cam_from_rig(name)
        return np.column_stack(
            [
                cam_from_rig[:, :3] @ pose[:, :3],
                cam_from_rig[:, :3] @ pose[:, 3] + cam_from_rig[:, 3],
            ]
        )

    def pose_numbers(self, name, pose) -> dict[str, float]:
        """Rotation vector from the true rotation, and the centre, in the first camera's frame."""
        true = relative(self.cam_from_rig("left"), self.cam_from_rig(name))
        turn = np.degrees(cv2.Rodrigues(pose[:, :3] @ true[:, :3].T)[0].ravel())
        numbers = [*turn, *(-pose[:, :3].T @ pose[:, 3])]
        return dict(zip([f"{name}.{key}" for key in POSE], numbers, strict=True))

    def truth(self) -> dict[str, float]:
        values = {}
        for name, lens_values in self.lenses.items():
            keys = [f"{name}.{key}" for key in self.model.parameter_names]
            values |= dict(zip(keys, lens_values, strict=True))
            true = relative(self.cam_from_rig("left"), self.cam_from_rig(name))
            values |= self.pose_numbers(name, true)
        return values


def near_boards(count: int, random: np.random.Generator) -> list[np.ndarray]:
    poses = []
    for _ in range(count):
        about, tilt = random.uniform(0, 2 * np.pi), np.radians(random.uniform(10, 40))
        turn = rotation([tilt * np.cos(about), tilt * np.sin(about), 0])
        turn = turn @ rotation([0, 0, random.uniform(-0.4, 0.4)]) @ np.diag([1.0, -1, -1])
        across = random.uniform(-1, 1, 2) * (110, 70)
        poses.append(np.column_stack([turn, [*across, random.uniform(130, 220)]]))
    return poses


PERSPECTIVE = Setup(BrownConrady, LENSES, PLACES, boards)
FISHEYE = Setup(
    KannalaBrandt,
    {
        "left": (260.0, 261.0, 322.0, 236.0, -0.010, 0.004, -0.003, 0.0006),
        "middle": (255.0, 256.0, 315.0, 243.0, -0.020, 0.006, -0.002, 0.0003),
        "right": (265.0, 264.0, 326.0, 240.0, 0.005, -0.002, 0.001, -0.0004),
    },
    {"left": (-0.2, -60.0), "middle": (0.0, 0.0), "right": (0.2, 60.0)},
    near_boards,
)


def rendered(board, lens, pose, *, paper=PAPER, ink=INK, blur_px=BLUR_PX, fine=8):
    """The picture without noise."""
    camera = Camera(Intrinsics.of_lens(lens, SIZE_PX), Pose(pose))
    drawn, covers = board, ()
    if not isinstance(board, Pattern):
        sheet = square_sheet(board)
        drawn, covers = BARE, (Paint(Cells(sheet.x_mm, sheet.y_mm, sheet.ink), ink),)
    return render_sheet(
        drawn, camera, paper=paper, ink=ink, blur_px=blur_px, covers=covers, supersampling=fine,
        bits=None,
    )  # fmt: skip


@jax.jit
def motion(lens, pose, uv_px):
    """(n, 2, 14) derivatives of pixels by eight lens parameters and a step of the pose."""

    def of_pixel(uv):
        ray = lens.unproject(uv)
        point = ray * (pose[:, 2] @ pose[:, 3]) / (pose[:, 2] @ ray)

        def after(step):
            changed_lens = lens.retract(step[:FOUND])
            turned = rotation_from_vector(step[8:11]) @ (point - pose[:, 3])
            return changed_lens.project_ray(turned + pose[:, 3] + step[11:])

        return jax.jacfwd(after)(jnp.zeros(14))

    return jax.vmap(of_pixel)(uv_px)


def information(board, lens, pose) -> np.ndarray:
    """(14, 14) information of one picture; its light, ink and blur are eliminated."""

    shown = partial(rendered, fine=3)  # enough for derivatives

    def shifted(axis, by):
        moved = np.array(lens.parameters)
        moved[2 + axis] += by
        return shown(board, type(lens).from_parameters(moved), pose)

    along = [(shifted(k, 0.1) - shifted(k, -0.1)).ravel() / 0.2 for k in (0, 1)]
    used = np.flatnonzero(np.hypot(*along) > 1e-3)
    uv_px = np.stack([used % SIZE_PX[0], used // SIZE_PX[0]], axis=1).astype(float)
    by_motion = np.asarray(motion(lens, pose, uv_px))
    rows = sum(along[k][used, None] * by_motion[:, k] for k in (0, 1)).T
    still = shown(board, lens, pose)
    looks = [
        shown(board, lens, pose, paper=PAPER + 1) - still,
        shown(board, lens, pose, ink=INK + 1) - still,
        (shown(board, lens, pose, blur_px=0.72) - shown(board, lens, pose, blur_px=0.68)) / 0.04,
    ]
    nuisance = np.stack([look.ravel() for look in looks])
    inner, across = nuisance @ nuisance.T, rows @ nuisance[:, used].T
    return (rows @ rows.T - across @ np.linalg.solve(inner, across.T)) / VARIANCE


def skew(v) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def bound(setup, board, poses, is_seen) -> dict[str, float]:
    """Standard deviations of lenses, and of poses in the frame of the first camera.

    is_seen : whether the board is found, by camera and shot.
    """
    total = np.zeros((HEAD + 6 * SHOTS,) * 2)
    for k, name in enumerate(setup.lenses):
        rig_pose, lens = setup.cam_from_rig(name), setup.lens(name)
        for s, pose in enumerate(poses):
            if not is_seen[name][s]:
                continue
            both = setup.cam_from_board(name, pose)
            chain = np.zeros((14, len(total)))
            chain[:8, 8 * k : 8 * k + 8] = np.eye(8)
            first, last = 24 + 6 * k, HEAD + 6 * s
            chain[8:, first : first + 6] = np.eye(6)
            chain[11:, first : first + 3] = -skew(rig_pose[:, :3] @ pose[:, 3])
            chain[8:11, last : last + 3] = chain[11:, last + 3 : last + 6] = rig_pose[:, :3]
            total += chain.T @ information(board, lens, both) @ chain
    free = np.r_[:24, 30 : len(total)]  # the first camera's pose is fixed
    covariance = np.zeros_like(total)
    covariance[np.ix_(free, free)] = np.linalg.inv(total[np.ix_(free, free)])
    sigma = {}
    for k, name in enumerate(setup.lenses):
        sigmas = np.sqrt(np.diag(covariance)[8 * k : 8 * k + 8])
        sigma |= {f"{name}.{key}": s for key, s in zip(setup.model.parameter_names, sigmas)}
        if not k:
            continue
        pose = relative(setup.cam_from_rig("left"), setup.cam_from_rig(name))
        along = pose[:, :3] @ setup.cam_from_rig("left")[:, 3]
        rows = np.zeros((6, len(total)))
        first = 24 + 6 * k
        rows[:3, first : first + 3] = np.degrees(np.eye(3))
        rows[3:, first : first + 3] = -pose[:, :3].T @ (skew(pose[:, 3]) + skew(along))
        rows[3:, first + 3 : first + 6] = -pose[:, :3].T
        sigmas = np.sqrt(np.diag(rows @ covariance @ rows.T))
        sigma |= {f"{name}.{key}": s for key, s in zip(POSE, sigmas, strict=True)}
    return sigma


def by_trinoc(setup, board, pictures, method):
    result = calibrate_rig(
        pictures, board, world="left", systematics=Systematics(), distortion=4, method=method,
        lens_model=setup.model.model,
    )  # fmt: skip
    values = dict(zip(result.parameters, result.values.tolist(), strict=True))
    for name in setup.lenses:
        values |= setup.pose_numbers(name, np.asarray(result.rig[name].cam_from_world))
    return values, {name: result.sigma(name) for name in result.parameters}, result


def is_found(board, picture) -> bool:
    try:
        return len(detect_target(np.rint(picture).astype("u1"), board)) > 0
    except DetectionError:
        return False


def labelled(result) -> dict:
    """Detections of each camera by shot, with the orientation that all cameras agree on."""
    detections = {name: [None] * SHOTS for name in result.cameras}
    for view in result.views:
        detections[result.cameras[view.camera]][view.shot] = view.detection
    return detections


def by_opencv_fisheye(setup, board, detections) -> dict[str, float]:
    values, lenses = {}, {}
    fixed = cv2.CALIB_FIX_SKEW | cv2.CALIB_USE_INTRINSIC_GUESS
    flags = fixed | cv2.CALIB_RECOMPUTE_EXTRINSIC
    for name, camera_detections in detections.items():
        pairs = [
            points(board, detection) for detection in camera_detections if detection is not None
        ]
        start = np.array([[260.0, 0, 319.5], [0, 260.0, 239.5], [0, 0, 1]])
        board_points, pixels = (
            [array.astype(float).swapaxes(0, 1) for array in part] for part in zip(*pairs)
        )
        _, matrix, curve, *_ = cv2.fisheye.calibrate(
            list(board_points), list(pixels), SIZE_PX, start, np.zeros(4), flags=flags,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9),
        )  # fmt: skip
        lenses[name] = matrix, np.ravel(curve)
        parameters = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *np.ravel(curve)]
        keys = [f"{name}.{key}" for key in setup.model.parameter_names]
        values |= dict(zip(keys, parameters, strict=True))
    for name in list(detections)[1:]:
        board_points, first_px, second_px = [], [], []
        for a, b in zip(detections["left"], detections[name], strict=True):
            if not (a and b):
                continue
            both, in_a, in_b = np.intersect1d(a.circle_index, b.circle_index, return_indices=True)
            board_points.append(np.pad(board.centres_mm[both], ((0, 0), (0, 1)))[None])
            first_px.append(a.centres_px[in_a][None])
            second_px.append(b.centres_px[in_b][None])
        (m1, d1), (m2, d2) = lenses["left"], lenses[name]
        # OpenCV requires equally many points of every shot.
        fewest = min(array.shape[1] for array in board_points)
        cut = [
            [array[:, :fewest] for array in part] for part in (board_points, first_px, second_px)
        ]
        turn, shift = cv2.fisheye.stereoCalibrate(
            *cut, m1, d1, m2, d2, SIZE_PX, flags=cv2.CALIB_FIX_INTRINSIC
        )[5:7]
        values |= setup.pose_numbers(name, np.column_stack([turn, np.ravel(shift)]))
    return values


def measure(setup: Setup, title: str, scenes: int, trials: int) -> None:
    board, true = BOARDS[title], setup.truth()
    lens_keys = [k for k in true if k.split(".")[1] in setup.model.parameter_names[:FOUND]]
    pose_keys = [k for k in true if k.split(".")[1] in POSE and not k.startswith("left.")]
    keys, count = [*lens_keys, *pose_keys], len(lens_keys)
    errors, normalised, sigma_ratios, seconds = {}, {}, {}, {}
    for scene in range(scenes):
        poses = setup.boards(SHOTS, np.random.default_rng(scene))
        clean = {}
        for name in setup.lenses:
            clean[name] = [
                rendered(board, setup.lens(name), setup.cam_from_board(name, pose))
                for pose in poses
            ]
        is_seen = {
            name: [is_found(board, picture) for picture in images] for name, images in clean.items()
        }
        bounds = bound(setup, board, poses, is_seen)
        for trial in range(trials):
            random = np.random.default_rng(1000 * scene + trial)
            pictures = {
                name: [
                    np.rint(np.clip(p + NOISE * random.normal(size=p.shape), 0, 255)).astype("u1")
                    for p in images
                ]
                for name, images in clean.items()
            }
            for method in ("pixels", "points"):
                start = time.perf_counter()
                try:
                    values, sigmas, result = by_trinoc(setup, board, pictures, method)
                except CalibrationError as error:
                    print(f"  {method} fails: {str(error)[:120]}")
                    continue
                seconds.setdefault(method, []).append(time.perf_counter() - start)
                off = np.array([values[k] - true[k] for k in keys])
                errors.setdefault(method, []).append(off / [bounds[k] for k in keys])
                sigma = np.array([sigmas[k] for k in keys])
                normalised.setdefault(method, []).append(off / sigma)
                sigma_ratios.setdefault(method, []).append(sigma / [bounds[k] for k in keys])
                print(f"  {scene} {trial} {method}", *(f"{rms(rows[method][-1]):.2f}" for rows in
                      (errors, normalised, sigma_ratios)), file=sys.stderr)  # fmt: skip
            try:
                if setup is FISHEYE:
                    values = by_opencv_fisheye(setup, board, labelled(result))
                else:
                    values = by_opencv(board, labelled(result), free=True)
            except cv2.error as error:
                print(f"  cv2 fails: {str(error)[:120]}")
                continue
            off = np.array([values[k] - true[k] for k in keys])
            errors.setdefault("cv2", []).append(off / [bounds[k] for k in keys])
    print(f"\n{title}, {setup.model.model}: {scenes} scenes, {trials} draws of noise each")
    print(
        "rms of            error over the bound: lenses, poses   over its claimed sigma"
        "   claimed over the bound      s"
    )
    for chain, rows in errors.items():
        table = np.array(rows)
        line = f"  {chain:26}{rms(table[:, :count]):9.2f} {rms(table[:, count:]):7.2f}"
        if chain in normalised:
            for scores in (np.array(normalised[chain]), np.array(sigma_ratios[chain])):
                line += f" {rms(scores[:, :count]):17.2f} {rms(scores[:, count:]):7.2f}"
            line += f" {np.median(seconds[chain]):10.1f}"
        print(line, flush=True)


def run(board: str | None, scenes: int, trials: int, *, fisheye: bool) -> None:
    """Print a table for each board."""
    jax.config.update("jax_enable_x64", True)
    for title in [board] if board else BOARDS:
        measure(FISHEYE if fisheye else PERSPECTIVE, title, scenes, trials)
