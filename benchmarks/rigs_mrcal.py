"""A rig and its lenses from many shots of a chessboard: trinoc beside mrcal, on the same corners.

    python benchmarks/rigs_mrcal.py [--trials 10] [--shots 10] [--real]

Needs the program mrcal-calibrate-cameras (Debian: apt-get install mrcal). Made: the rig and the
noise of `rigs_from_shots.py`; errors over the bound, as there. mrcal solves lenses of the same four
coefficients, with its own outlier rejection and regularisation, for a flat board. Real
(TRINOC_DATA): `stereo_chessboard`, the corners that trinoc detects; both with lenses of five
coefficients and a board that may be bent.
"""

import argparse
import ast
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from rigs_from_shots import (
    BOARDS,
    LENSES,
    POSE,
    SIZE_PX,
    boards,
    by_trinoc,
    observed,
    pose_numbers,
    relative,
    rms,
    truth,
)

from trinoc.calib import Detection, detect_target
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.targets.checkers import Chessboard
from trinoc.geometry.lenses.polynomial import BrownConrady

PROGRAM = "mrcal-calibrate-cameras"
Found = Mapping[str, Sequence[Detection | None]]


def by_mrcal(
    board: Chessboard,
    found: Found,
    size_px: tuple[int, int],
    coefficients: int,
    options: Sequence[str],
) -> tuple[dict[str, dict], float]:
    """(each camera's intrinsics and [turn, shift] from the first camera's frame, seconds)."""
    with tempfile.TemporaryDirectory() as folder:
        lines = ["# filename x y level"]
        for name, own in found.items():
            for shot, detection in enumerate(own):
                places = np.full((len(board), 2), np.nan)
                if detection is not None:
                    places[detection.circle_index] = detection.centres_px
                if detection is None:
                    continue
                lines += [
                    f"{name}{shot:03}.png {u:.6f} {v:.6f} 0" if np.isfinite(u) else
                    f"{name}{shot:03}.png - - -"
                    for u, v in places
                ]  # fmt: skip
        Path(folder, "corners.vnl").write_text("\n".join(lines) + "\n", encoding="utf-8")
        start = time.perf_counter()
        done = subprocess.run(
            [
                *(PROGRAM, "--corners-cache", "corners.vnl", "--focal", "800", "--outdir", "."),
                *("--lensmodel", f"LENSMODEL_OPENCV{coefficients}"),
                *("--imagersize", *map(str, size_px), "--object-spacing", str(board.square_mm)),
                *("--object-width-n", str(board.columns), "--object-height-n", str(board.rows)),
                *options,
                *(f"{name}*.png" for name in found),
            ],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        seconds = time.perf_counter() - start
        if done.returncode:
            raise SystemExit(f"{PROGRAM} fails:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
        print("  mrcal:", next((x for x in done.stdout.splitlines() if "RMS" in x), "").strip())
        return {
            name: _model(Path(folder, f"camera-{number}.cameramodel"))
            for number, name in enumerate(found)
        }, seconds


def _model(file: Path) -> dict:
    """A cameramodel is a dictionary of Python with comments and values that are not."""
    text = "\n".join(
        line.split("#")[0]
        for line in file.read_text(encoding="utf-8").splitlines()
        if "optimization_inputs" not in line and not line.startswith(" b'")
    )
    return {
        key: ast.literal_eval(text.split(f"'{key}':")[1].split("]")[0].strip() + "]")
        for key in ("intrinsics", "extrinsics")
    }


def numbers(models: Mapping[str, dict]) -> dict[str, float]:
    """The same values as `truth`."""
    poses = {
        name: np.column_stack(
            [
                cv2.Rodrigues(np.array(model["extrinsics"][:3], dtype=float))[0],
                model["extrinsics"][3:],
            ]
        )
        for name, model in models.items()
    }
    first = next(iter(poses))
    values: dict[str, float] = {}
    for name, model in models.items():
        own = [*model["intrinsics"], 0.0][:9]
        keys = [f"{name}.{key}" for key in BrownConrady.parameter_names]
        values |= dict(zip(keys, own, strict=True))
        values |= pose_numbers(name, relative(poses[first], poses[name]))
    return values


def made(trials: int, shots: int) -> None:
    true = truth()
    keys = [k for k in true if k.split(".")[1] in BrownConrady.parameter_names[:8]]
    lenses = len(keys)
    keys += [k for k in true if k.split(".")[1] in POSE and not k.startswith("left.")]
    board, sigma_px = BOARDS["chessboard"]
    assert isinstance(board, Chessboard)
    errors: dict[str, list] = {"trinoc": [], "mrcal": []}
    seconds: dict[str, list] = {"trinoc": [], "mrcal": []}
    for trial in range(trials):
        random = np.random.default_rng(trial)
        found = observed(board, sigma_px, boards(shots, random), random)
        start = time.perf_counter()
        own, _, bound, _ = by_trinoc(board, found)
        seconds["trinoc"].append(time.perf_counter() - start)
        models, spent = by_mrcal(board, found, SIZE_PX, 4, ["--skip-calobject-warp-solve"])
        seconds["mrcal"].append(spent)
        for name, values in (("trinoc", own), ("mrcal", numbers(models))):
            errors[name].append([(values[k] - true[k]) / bound[k] for k in keys])
    print(f"chessboard, {sigma_px} px, {len(LENSES)} cameras, {shots} shots, {trials} trials")
    print("error over the bound (rms)   lenses   poses   median s")
    for name, rows in errors.items():
        table = np.array(rows)
        print(
            f"  {name:26} {rms(table[:, :lenses]):6.2f} {rms(table[:, lenses:]):7.2f}"
            f" {np.median(seconds[name]):10.1f}"
        )


def real(folder: Path) -> None:
    board = Chessboard(rows=6, columns=9, square_mm=1.0)
    found = {
        name: [detect_target(cv2.imread(str(file), 0), board)
               for file in sorted(folder.glob(f"{name}*.jpg"))]
        for name in ("left", "right")
    }  # fmt: skip
    result = calibrate_rig(found, board, world="left")
    size_px = next(each.image_size_px for each in found["left"])
    print("stereo_chessboard")
    models, _ = by_mrcal(board, found, size_px, 5, [])
    for name in found:
        fx, fy = (result.value(f"{name}.{key}") for key in ("fx_px", "fy_px"))
        own = models[name]["intrinsics"]
        print(
            f"  {name}: rms {result.rms_px(name):.3f} px; f trinoc {fx:.2f} {fy:.2f} "
            f"+- {result.sigma(f'{name}.fx_px'):.2f}, mrcal {own[0]:.2f} {own[1]:.2f}"
        )
    pose = np.asarray(models["right"]["extrinsics"][3:])
    baseline = np.linalg.norm(np.asarray(result.rig["right"].cam_from_world)[:, 3])
    print(f"  baseline: trinoc {baseline:.4f} squares, mrcal {np.linalg.norm(pose):.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--shots", type=int, default=10)
    parser.add_argument("--real", action="store_true")
    options = parser.parse_args()
    if shutil.which(PROGRAM) is None:
        raise SystemExit(f"{PROGRAM} is not installed (Debian: apt-get install mrcal).")
    made(options.trials, options.shots)
    folder = Path(os.environ.get("TRINOC_DATA", "")) / "stereo_chessboard"
    if options.real and folder.is_dir():
        real(folder)


if __name__ == "__main__":
    main()
