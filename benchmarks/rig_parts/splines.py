"""A lens with a bump that no polynomial describes: polynomials, splines and mrcal's splines.

Made cameras (1280 x 960 px), each with a lens of Brown and Conrady and a bump of Gauss, which moves
pixels by up to `bump_px` somewhere in the picture, some way, with a standard deviation of 100 to
180 px; a chessboard of 9 x 12 corners near it, noise of .1 px. Errors are of pixels over the field,
root mean square per axis, a turn of the camera taken out; sigmas are those of the same pixels as
they are claimed. Without a bump (0 px) it shows what a correction costs that is not needed.
mrcal (Debian: apt-get install mrcal) is run as a program, with the splines of `MRCAL_SPLINES`, or
OpenCV's 8 coefficients.
"""

import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rig_parts.mrcal import PROGRAM
from trinoc.calib import Detection
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry import AbstractLens
from trinoc.geometry.lenses.polynomial import BrownConrady

SIZE_PX, SIGMA_PX = (1280, 960), 0.1
BOARD = Chessboard(rows=9, columns=12, square_mm=25.0)
CORE = BrownConrady.from_parameters(
    np.array([1000.0, 1003.0, 642.0, 476.0, -0.25, 0.08, 0.001, -0.0005, -0.01])
)
SYSTEM_PYTHON = "/usr/bin/python3"
MRCAL_SPLINES = "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=12_Ny=10_fov_x_deg=76"
_PROJECT = """
import json, sys, mrcal, numpy as np
model = mrcal.cameramodel(sys.argv[1])
points = np.array(json.load(sys.stdin))
print(json.dumps(mrcal.project(points, *model.intrinsics()).tolist()))
"""
project = jax.jit(jax.vmap(lambda lens, ray: lens.project_ray(ray), (None, 0)))
unproject = jax.jit(jax.vmap(lambda lens, uv_px: lens.unproject(uv_px), (None, 0)))


class Error(NamedTuple):
    """Errors over the field in px: rms, largest, reported sigma, and error over sigma."""

    rms: float
    largest: float
    sigma: float
    over_sigma: float


class Bump(NamedTuple):
    """Displacement of the core's pixels: amplitude (2,), centre and width, px."""

    height: Float[np.ndarray, "2"]
    middle: Float[np.ndarray, "2"]
    width: float


def bump_of(seed: int, height_px: float) -> Bump:
    """A bump at a random position of the picture, not at its edge."""
    random = np.random.default_rng(1000 + seed)
    angle = random.uniform(0.0, 2.0 * np.pi)
    middle = random.uniform(0.15, 0.85, 2) * SIZE_PX
    return Bump(
        height_px * np.array([np.cos(angle), np.sin(angle)]), middle, random.uniform(100.0, 180.0)
    )


def seen(rays: Float[np.ndarray, "n 3"], bump: Bump) -> Float[np.ndarray, "n 2"]:
    """The pixels of rays through the true lens."""
    uv_px = np.asarray(project(CORE, rays))
    away = np.sum((uv_px - bump.middle) ** 2, axis=1) / bump.width**2
    return uv_px + np.exp(-0.5 * away)[:, None] * bump.height


def shots(count: int, seed: int, bump: Bump) -> list[Detection]:
    """Detections of a board all over the picture, tilted by up to 40 degrees."""
    random, detections = np.random.default_rng(seed), []
    while len(detections) < count:
        about, tilt = random.uniform(0, 2 * np.pi), np.radians(random.uniform(16, 40))
        turn = Rotation.from_rotvec(tilt * np.array([np.cos(about), np.sin(about), 0.0]))
        turn = turn * Rotation.from_rotvec([0.0, 0.0, random.uniform(-0.3, 0.3)])
        depth = random.uniform(330.0, 500.0)
        position = depth * np.array([*random.uniform((-0.45, -0.3), (0.45, 0.3)), 1.0])
        facing = turn.as_matrix() @ np.diag([1.0, -1.0, -1.0])
        points = BOARD.centres_mm @ facing[:, :2].T + position
        uv_px = seen(points, bump)
        inside = ((uv_px > 5) & (uv_px < np.array(SIZE_PX) - 6)).all(axis=1) & (points[:, 2] > 50)
        if inside.sum() < 40:
            continue
        number = int(inside.sum())
        detections.append(
            Detection(
                circle_index=np.flatnonzero(inside),
                centres_px=uv_px[inside] + random.normal(0, SIGMA_PX, (number, 2)),
                covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (number, 1, 1)),
                shape_px2=np.full((number, 2, 2), np.nan),
                lines_px=np.full((2, 3), np.nan),
                image_size_px=SIZE_PX,
            )
        )
    return detections


def field_rays() -> Float[np.ndarray, "n 3"]:
    """Rays of the core, to all of the picture but its edge."""
    u, v = (np.linspace(20, side - 21, n) for side, n in zip(SIZE_PX, (24, 18)))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return np.asarray(unproject(CORE, pixels))


def turned_error(
    pixels: Callable[[np.ndarray], np.ndarray], bump: Bump
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "3"]]:
    """Errors of a lens over the field after the rotation that minimises them, and the rotation."""
    rays, true = field_rays(), seen(field_rays(), bump)

    def off(turn: np.ndarray) -> np.ndarray:
        return (pixels(rays @ Rotation.from_rotvec(turn).as_matrix().T) - true).ravel()

    turn = least_squares(off, np.zeros(3), x_scale=0.1, max_nfev=12).x
    return off(turn).reshape(-1, 2), turn


def sigmas_px(
    lens: AbstractLens, covariance: np.ndarray, turn: np.ndarray
) -> Float[np.ndarray, "n 2"]:
    """Reported sigmas of the same pixels, without the part that a rotation explains."""
    rays = field_rays() @ Rotation.from_rotvec(turn).as_matrix().T

    @jax.jit
    @jax.jacfwd
    def by_parameters(step: jax.Array) -> jax.Array:
        moved = lens.with_parameters(lens.parameters + step[3:])
        turned = rays + jnp.cross(step[None, :3], rays)
        return jax.vmap(lambda ray: jnp.asarray(moved.project_ray(ray)))(turned).ravel()

    by_step = np.asarray(by_parameters(jnp.zeros(3 + len(lens.parameters))))
    by_turn, by_lens = by_step[:, :3], by_step[:, 3:]
    by_lens = by_lens - by_turn @ np.linalg.lstsq(by_turn, by_lens, rcond=None)[0]
    variance = np.einsum("ip,pq,iq->i", by_lens, covariance, by_lens)
    return np.sqrt(variance).reshape(-1, 2)


def by_trinoc(made: Sequence[Detection], model: str, bump: Bump) -> tuple[Error, float]:
    """(error, seconds)."""
    start = time.perf_counter()
    result = calibrate_rig(
        {"camera": list(made)}, BOARD, lens_model=model, systematics=Systematics()
    )
    seconds = time.perf_counter() - start
    assert result.has_rig
    lens = result.rig["camera"].intrinsics.lens
    rows = [result.parameters.index(f"camera.{name}") for name in lens.parameter_names]
    error, turn = turned_error(lambda rays: np.asarray(project(lens, rays)), bump)
    sigma = sigmas_px(lens, result.covariance[np.ix_(rows, rows)], turn)
    over = float(np.sqrt(np.mean(error**2) / np.mean(sigma**2)))
    rms = float(np.sqrt(np.mean(error**2)))
    return Error(rms, float(np.abs(error).max()), float(np.sqrt(np.mean(sigma**2))), over), seconds


def by_mrcal(made: Sequence[Detection], model: str, bump: Bump) -> tuple[Error, float]:
    """(error, seconds); the sigmas are NaN, because mrcal is not asked for them."""
    lines = ["# filename x y level"]
    for shot, detection in enumerate(made):
        corners_px = np.full((len(BOARD), 2), np.nan)
        corners_px[detection.circle_index] = detection.centres_px
        lines += [
            f"c{shot:03}.png {u:.6f} {v:.6f} 0" if np.isfinite(u) else f"c{shot:03}.png - - -"
            for u, v in corners_px
        ]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "corners.vnl").write_text("\n".join(lines) + "\n", encoding="utf-8")
        start = time.perf_counter()
        subprocess.run(
            [
                *(PROGRAM, "--corners-cache", "corners.vnl", "--focal", "1000", "--outdir", "."),
                *("--lensmodel", model, "--imagersize", *map(str, SIZE_PX)),
                *("--object-spacing", str(BOARD.square_mm / 1000), "--object-width-n"),
                *(str(BOARD.columns), "--object-height-n", str(BOARD.rows)),
                *("--skip-calobject-warp-solve", "c*.png"),
            ],
            cwd=folder, capture_output=True, text=True, check=True,
        )  # fmt: skip
        seconds = time.perf_counter() - start

        def pixels(rays: np.ndarray) -> np.ndarray:
            done = subprocess.run(
                [SYSTEM_PYTHON, "-c", _PROJECT, str(Path(folder, "camera-0.cameramodel"))],
                input=json.dumps(rays.tolist()), capture_output=True, text=True, check=True,
            )  # fmt: skip
            return np.array(json.loads(done.stdout))

        error, _ = turned_error(pixels, bump)
    rms, largest = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    return Error(rms, largest, float("nan"), float("nan")), seconds


def run(trials: int, shots_each: int, bump_px: float) -> None:
    """Print one row for each lens."""
    methods: dict[str, Callable[[Sequence[Detection], str, Bump], tuple[Error, float]]] = {
        "brown_conrady": by_trinoc,
        "rational": by_trinoc,
        "splined_brown_conrady": by_trinoc,
    }
    if shutil.which(PROGRAM) is not None:
        methods |= {"LENSMODEL_OPENCV8": by_mrcal, MRCAL_SPLINES: by_mrcal}
    bumps = [bump_of(seed, bump_px) for seed in range(trials)]
    draws = [shots(shots_each, seed, bump) for seed, bump in enumerate(bumps)]
    print("lens: rms px, largest px, claimed sigma px, error over it; seconds of the last draw")
    for model, method in methods.items():
        results = []
        for made, bump in zip(draws, bumps, strict=True):
            try:
                results.append(method(made, model, bump))
            except subprocess.CalledProcessError as error:
                print(f"{model} fails: {error.stderr.strip().splitlines()[-1:]}")
        errors = np.array([error for error, _ in results])
        rms, sigma = (np.sqrt(np.mean(errors[:, k] ** 2)) for k in (0, 2))
        print(
            f"{model:24} {rms:.4f} {errors[:, 1].mean():.3f} {sigma:.4f} {rms / sigma:.2f}; "
            f"{results[-1][1]:.1f} s, {len(results)} draws",
            flush=True,
        )
