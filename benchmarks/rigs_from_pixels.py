"""A rig and its lenses from the grey levels of many shots: errors over the bound of the pixels.

    python benchmarks/rigs_from_pixels.py [--trials 3] [--scenes 2] [--board sheet|chessboard]

The rig of `rigs_from_shots.py`: three cameras with unknown lenses of four coefficients, ten shots
of our sheet or of a chessboard of its size, rendered by rays (640 x 480 px, ink 25, paper 230, blur
.7 px, noise 2 grey levels, rounded). The bound is Cramer and Rao's, of all pixels, with light, ink
and blur of each picture unknown: a picture's change by every parameter is its gradient along the
motion of what it shows. Beside `method="pixels"`: `method="points"`, and on the same detected
places cv2.calibrateCamera, then cv2.stereoCalibrate with lenses free.
"""

import argparse
import time
from types import SimpleNamespace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from rigs_from_shots import (
    LENSES,
    POSE,
    SIZE_PX,
    boards,
    by_opencv,
    cam_from_rig,
    pose_numbers,
    relative,
    rms,
    truth,
)

from trinoc.calib import Chessboard, Pattern, Systematics, calibrate_rig, dark_squares
from trinoc.geometry import BrownConrady, Camera, Intrinsics, Pose, rotation_from_vector
from trinoc.synth import render_sheet
from trinoc.synth.layers import Paint
from trinoc.synth.shapes import ConvexPolygon

BOARDS = {"sheet": Pattern.default(), "chessboard": Chessboard(rows=8, columns=8, square_mm=20.0)}
PAPER, INK, BLUR_PX, NOISE = 230.0, 25.0, 0.7, 2.0
VARIANCE = NOISE**2 + 1 / 12
SHOTS, HEAD = 10, 8 * len(LENSES) + 6 * len(LENSES)
BARE = SimpleNamespace(
    centres_mm=np.zeros((0, 2)), radius_mm=np.zeros(0), inner_radius_mm=np.zeros(0),
    line_width_mm=0.0, line_half_length_mm=(0.0, 0.0), line_style="stop", line_gap_mm=0.0,
)  # fmt: skip


def rendered(board, lens, pose, *, paper=PAPER, ink=INK, blur_px=BLUR_PX) -> np.ndarray:
    """The picture without noise."""
    camera = Camera(Intrinsics.of_lens(lens, SIZE_PX), Pose(pose))
    drawn, above = board, ()
    if isinstance(board, Chessboard):
        dark = np.argwhere(dark_squares(board.rows + 1, board.columns + 1))
        side = board.square_mm
        places = [(c - 0.5 * board.columns, 0.5 * board.rows - r) for r, c in dark]
        squares = [ConvexPolygon.rectangle(side * np.array(p), (side, side)) for p in places]
        drawn, above = BARE, tuple(Paint(square, ink) for square in squares)
    return render_sheet(
        drawn, camera, paper=paper, ink=ink, blur_px=blur_px, above=above, supersampling=6,
        dtype="float64",
    )  # fmt: skip


@jax.jit
def motion(lens, pose, uv_px):
    """(n, 2, 14) of what pixels show, by eight numbers of the lens and a step of the pose."""

    def of_pixel(uv):
        ray = jnp.append(lens.normalised_from_pixel(uv), 1.0)
        point = ray * (pose[:, 2] @ pose[:, 3]) / (pose[:, 2] @ ray)

        def after(step):
            own = type(lens).from_parameters(lens.parameters + jnp.append(step[:8], 0.0))
            turned = rotation_from_vector(step[8:11]) @ (point - pose[:, 3])
            return own.project_ray(turned + pose[:, 3] + step[11:])

        return jax.jacfwd(after)(jnp.zeros(14))

    return jax.vmap(of_pixel)(uv_px)


def information(board, lens, pose) -> np.ndarray:
    """(14, 14) of one picture, its light, ink and blur eliminated."""

    def shifted(axis, by):
        moved = np.array(lens.parameters)
        moved[2 + axis] += by
        return rendered(board, BrownConrady.from_parameters(moved), pose)

    along = [(shifted(k, 0.1) - shifted(k, -0.1)).ravel() / 0.2 for k in (0, 1)]
    used = np.flatnonzero(np.hypot(*along) > 1e-3)
    uv_px = np.stack([used % SIZE_PX[0], used // SIZE_PX[0]], axis=1).astype(float)
    by_motion = np.asarray(motion(lens, pose, uv_px))
    rows = sum(along[k][used, None] * by_motion[:, k] for k in (0, 1)).T
    still = rendered(board, lens, pose)
    looks = [
        rendered(board, lens, pose, paper=PAPER + 1) - still,
        rendered(board, lens, pose, ink=INK + 1) - still,
        (rendered(board, lens, pose, blur_px=0.72) - rendered(board, lens, pose, blur_px=0.68))
        / 0.04,
    ]
    whole = np.stack([look.ravel() for look in looks])
    inner, across = whole @ whole.T, rows @ whole[:, used].T
    return (rows @ rows.T - across @ np.linalg.solve(inner, across.T)) / VARIANCE


def skew(v) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def bound(board, poses) -> dict[str, float]:
    """Standard deviations of lenses, and of poses in the frame of the first camera."""
    whole = np.zeros((HEAD + 6 * SHOTS,) * 2)
    for k, (name, values) in enumerate(LENSES.items()):
        own, lens = cam_from_rig(name), BrownConrady.from_parameters(np.array(values))
        for s, pose in enumerate(poses):
            both = np.column_stack([own[:, :3] @ pose[:, :3], own[:, :3] @ pose[:, 3] + own[:, 3]])
            chain = np.zeros((14, len(whole)))
            chain[:8, 8 * k : 8 * k + 8] = np.eye(8)
            first, last = 24 + 6 * k, HEAD + 6 * s
            chain[8:, first : first + 6] = np.eye(6)
            chain[11:, first : first + 3] = -skew(own[:, :3] @ pose[:, 3])
            chain[8:11, last : last + 3] = chain[11:, last + 3 : last + 6] = own[:, :3]
            whole += chain.T @ information(board, lens, both) @ chain
    kept = np.r_[:24, 30 : len(whole)]  # the first camera's pose is held
    covariance = np.zeros_like(whole)
    covariance[np.ix_(kept, kept)] = np.linalg.inv(whole[np.ix_(kept, kept)])
    sigma = {}
    for k, name in enumerate(LENSES):
        own = np.sqrt(np.diag(covariance)[8 * k : 8 * k + 8])
        sigma |= {f"{name}.{key}": s for key, s in zip(BrownConrady.parameter_names, own)}
        if not k:
            continue
        pose = relative(cam_from_rig("left"), cam_from_rig(name))
        along = pose[:, :3] @ cam_from_rig("left")[:, 3]
        rows = np.zeros((6, len(whole)))
        first = 24 + 6 * k
        rows[:3, first : first + 3] = np.degrees(np.eye(3))
        rows[3:, first : first + 3] = -pose[:, :3].T @ (skew(pose[:, 3]) + skew(along))
        rows[3:, first + 3 : first + 6] = -pose[:, :3].T
        own = np.sqrt(np.diag(rows @ covariance @ rows.T))
        sigma |= {f"{name}.{key}": s for key, s in zip(POSE, own, strict=True)}
    return sigma


def by_trinoc(board, pictures, method):
    found = calibrate_rig(
        pictures, board, world="left", systematics=Systematics(), distortion=4, method=method
    )
    values = dict(zip(found.parameters, found.values.tolist(), strict=True))
    for name in LENSES:
        values |= pose_numbers(name, np.asarray(found.rig[name].cam_from_world))
    return values, {name: found.sigma(name) for name in found.parameters}, found


def labelled(result) -> dict:
    """The detections of each camera by shot, turned as all cameras have them."""
    found = {name: [None] * SHOTS for name in result.cameras}
    for view in result.views:
        found[result.cameras[view.camera]][view.shot] = view.detection
    return found


def measure(title: str, scenes: int, trials: int) -> None:
    board, true = BOARDS[title], truth()
    lens_keys = [k for k in true if k.split(".")[1] in BrownConrady.parameter_names[:8]]
    pose_keys = [k for k in true if k.split(".")[1] in POSE and not k.startswith("left.")]
    keys, count = [*lens_keys, *pose_keys], len(lens_keys)
    errors, claimed, seconds = {}, {}, {}
    for scene in range(scenes):
        poses = boards(SHOTS, np.random.default_rng(scene))
        least = bound(board, poses)
        clean = {}
        for name, values in LENSES.items():
            own, lens = cam_from_rig(name), BrownConrady.from_parameters(np.array(values))
            clean[name] = [
                rendered(board, lens, np.column_stack(
                    [own[:, :3] @ pose[:, :3], own[:, :3] @ pose[:, 3] + own[:, 3]]))
                for pose in poses
            ]  # fmt: skip
        for trial in range(trials):
            random = np.random.default_rng(1000 * scene + trial)
            pictures = {
                name: [
                    np.rint(np.clip(p + NOISE * random.normal(size=p.shape), 0, 255)).astype("u1")
                    for p in own
                ]
                for name, own in clean.items()
            }
            for method in ("pixels", "points"):
                start = time.perf_counter()
                values, sigmas, result = by_trinoc(board, pictures, method)
                seconds.setdefault(method, []).append(time.perf_counter() - start)
                off = np.array([values[k] - true[k] for k in keys])
                errors.setdefault(method, []).append(off / [least[k] for k in keys])
                claimed.setdefault(method, []).append(off / [sigmas[k] for k in keys])
            try:
                values = by_opencv(board, labelled(result), free=True)
            except cv2.error as error:
                print(f"  cv2 fails: {str(error)[:120]}")
                continue
            off = np.array([values[k] - true[k] for k in keys])
            errors.setdefault("cv2", []).append(off / [least[k] for k in keys])
    print(f"\n{title}: {scenes} scenes, {trials} draws of noise each")
    print("error over (rms)    the bound: lenses   poses   its claimed sigma: lenses   poses    s")
    for chain, rows in errors.items():
        table = np.array(rows)
        line = f"  {chain:26}{rms(table[:, :count]):9.2f} {rms(table[:, count:]):7.2f}"
        if chain in claimed:
            own = np.array(claimed[chain])
            line += f" {rms(own[:, :count]):26.2f} {rms(own[:, count:]):7.2f}"
            line += f" {np.median(seconds[chain]):6.1f}"
        print(line, flush=True)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--scenes", type=int, default=2)
    parser.add_argument("--board", choices=tuple(BOARDS))
    options = parser.parse_args()
    for title in [options.board] if options.board else BOARDS:
        measure(title, options.scenes, options.trials)


if __name__ == "__main__":
    main()
