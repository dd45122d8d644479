"""mrcal (Debian: apt-get install mrcal) on the corners of a chessboard, as a program."""

import ast
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from trinoc.calib import Detection
from trinoc.calib.targets.checkers import Chessboard

PROGRAM = "mrcal-calibrate-cameras"
Found = Mapping[str, Sequence[Detection | None]]


def calibrate_by_mrcal(
    board: Chessboard,
    detections: Found,
    size_px: tuple[int, int],
    coefficients: int,
    options: Sequence[str],
) -> tuple[dict[str, dict], float]:
    """(each camera's intrinsics and [turn, shift] from the first camera's frame, seconds)."""
    with tempfile.TemporaryDirectory() as folder:
        lines = ["# filename x y level"]
        for name, camera_detections in detections.items():
            for shot, detection in enumerate(camera_detections):
                pixels = np.full((len(board), 2), np.nan)
                if detection is not None:
                    pixels[detection.circle_index] = detection.centres_px
                if detection is None:
                    continue
                lines += [
                    f"{name}{shot:03}.png {u:.6f} {v:.6f} 0" if np.isfinite(u) else
                    f"{name}{shot:03}.png - - -"
                    for u, v in pixels
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
                *(f"{name}*.png" for name in detections),
            ],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        seconds = time.perf_counter() - start
        if done.returncode:
            raise SystemExit(f"{PROGRAM} fails:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
        return {
            name: _model(Path(folder, f"camera-{number}.cameramodel"))
            for number, name in enumerate(detections)
        }, seconds


def _model(file: Path) -> dict:
    """Parse a cameramodel file: a Python dictionary with comments and non-literal values."""
    text = "\n".join(
        line.split("#")[0]
        for line in file.read_text(encoding="utf-8").splitlines()
        if "optimization_inputs" not in line and not line.startswith(" b'")
    )
    return {
        key: ast.literal_eval(text.split(f"'{key}':")[1].split("]")[0].strip() + "]")
        for key in ("intrinsics", "extrinsics")
    }
