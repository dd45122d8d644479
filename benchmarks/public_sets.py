"""Calibrate every public image set of `public_sets.toml`, beside OpenCV and mrcal.

    python benchmarks/public_sets.py FOLDER [--only NAME ...] [--aside] [--project CHECKOUT]
        [--out results.jsonl]

FOLDER holds a folder for each set, with a folder of images for each camera and `board.json`, as
`public_sets_collect.py` writes them. Every set runs in a process of its own, as
`trinoc calibrate-rig CAMERA=FOLDER/NAME/CAMERA ... --board board.json` does, and starts cold except
for the compile cache. Sets that are kept aside run with `--aside` alone.

Columns: images found by trinoc and OpenCV; status; rms of the residuals weighted by their
variances, px; residual of held-out shots, px (trinoc by `CrossValidation`; OpenCV and mrcal fitted
to every second shot, the board's pose in each other shot by solvePnP, both on OpenCV's corners);
sigmas x (the largest camera's); ratio of the halves; the largest difference of a focal length from
OpenCV's in units of both sigmas; processor seconds and peak memory of trinoc; processor seconds of
OpenCV's detection and fit, and of mrcal's fit; warnings on stderr, and notes. mrcal runs where its
program is installed and the board is a chessboard.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
LIMIT_S = 1500.0
COLUMNS = (
    *("set", "found", "cv", "status", "w.rms", "held", "cv held", "mrcal"),
    *("x", "halves", "df/s", "cpu s", "MB", "cv det", "cv fit", "mrcal s", "warn"),
)


def by_trinoc(folder: Path, entry: dict[str, Any]) -> dict[str, Any]:
    """Result of the command line. Cameras not taken at one moment are calibrated singly."""
    if entry.get("one_moment", True):
        return _calibrate(folder, entry)
    answers = [_calibrate(folder, {**entry, "cameras": [name]}) for name in entry["cameras"]]
    good = [answer for answer in answers if "focal" in answer]
    if len(good) < len(answers):
        return next(answer for answer in answers if "focal" not in answer)
    merged = dict(max(good, key=lambda answer: max(answer["sigma_factor"].values())))
    for key in ("rms_px", "sigma_factor", "focal", "failures"):
        merged[key] = {name: value for answer in good for name, value in answer[key].items()}
    for key in ("found", "images"):
        merged[key] = sum(answer[key] for answer in good)
    return merged


def _calibrate(folder: Path, entry: dict[str, Any]) -> dict[str, Any]:
    import numpy as np

    from trinoc.cli.calibrate_rig import calibrate_shots
    from trinoc.cli.command import Job
    from trinoc.cli.main import compile_quickly
    from trinoc.errors import TrinocError
    from trinoc.io.compile_cache import enable_compile_cache

    # As `trinoc.cli.program` does; `run_worker` sets OPENBLAS_NUM_THREADS, too.
    compile_quickly()
    enable_compile_cache()
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch, "rig.json")
        folders = {camera: folder / camera for camera in entry["cameras"]}
        choices = {"lens_model": entry.get("lens_model", "default")}
        job = Job(quiet=True, command_line="benchmark")
        try:
            result, outcome = calibrate_shots(
                folders, (folder / "board.json",), (), {}, choices, None, out, job
            )
        except TrinocError as error:
            return {"status": "refused", "error": str(error)}
        except Exception as error:  # every other exception is a failure to count
            return {"status": "TRACEBACK", "error": f"{type(error).__name__}: {error}"}
        try:
            from trinoc.io.rig_json import load_rig

            load_rig(out)
            readable = ""
        except Exception as error:
            readable = str(error)
    squares, weights = [], []
    for view, errors in zip(result.views, result.residuals_px, strict=True):
        is_used = view.rows_used
        variance = np.trace(view.detection.covariance_px2, axis1=1, axis2=2)
        variance = variance * getattr(view, "sigma_ratio", 1.0) ** 2
        squares.append(np.sum(errors**2, axis=1)[is_used] / variance[is_used])
        weights.append(1 / variance[is_used])
    held_out, halves = result.cross_validation, result.halves
    focal = {
        camera: [result.value(f"{camera}.{axis}_px") for axis in ("fx", "fy")]
        + [result.sigma(f"{camera}.{axis}_px") for axis in ("fx", "fy")]
        for camera in result.cameras
        if f"{camera}.fx_px" in result.parameters
    }
    return {
        "status": result.overall_status.name.lower(),
        "readable": readable,
        "found": len({(v.camera, v.shot) for v in result.views if v.used.any()}),
        "images": sum(len(list((folder / camera).iterdir())) for camera in entry["cameras"]),
        "weighted_rms_px": float(
            np.sqrt(np.concatenate(squares).sum() / np.concatenate(weights).sum())
        ),
        "rms_px": {camera: result.rms_px(camera) for camera in result.cameras},
        "held_out_px": None
        if held_out is None
        else [max(held_out.own_px.values()), max(held_out.across_px.values(), default=0.0)],
        "held_out_cameras_px": None if held_out is None else dict(held_out.own_px),
        "sigma_factor": {name: fit.sigma_factor for name, fit in result.fits.items()},
        "variance_factor": result.solved_problem.variance_factor
        if result.solved_problem is not None
        else None,
        "halves": None if halves is None else halves.ratio,
        "focal": focal,
        "notes": list(result.notes),
        "refused": list(result.refused),
        "failures": dict(result.failures),
        "summary": outcome.text,
    }


def detect_by_opencv(files: list[Path], board: Any) -> dict[str, Any]:
    """Board points (m, 3) and pixels (m, 2) by file name, by OpenCV's usual search."""
    import cv2
    import numpy as np

    from trinoc.calib.targets.checkers import Charuco, Chessboard
    from trinoc.io.images import read_image

    corners = {}
    for file in files:
        grey = read_image(file)
        if grey.ndim == 3:
            grey = cv2.cvtColor(grey[..., :3], cv2.COLOR_RGB2GRAY)
        if grey.dtype != np.uint8:
            grey = cv2.normalize(grey, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)
        if isinstance(board, Charuco):
            dictionary = getattr(cv2.aruco, f"DICT_{board.dictionary.upper()}", None)
            if dictionary is None:
                return {}
            charuco = cv2.aruco.CharucoBoard(
                (board.columns, board.rows),
                board.square_mm,
                board.marker_mm,
                cv2.aruco.getPredefinedDictionary(dictionary),
            )
            plain = 255 - grey if board.inverted else grey
            uv, index, *_ = cv2.aruco.CharucoDetector(charuco).detectBoard(plain)
            if index is not None and len(index) >= 6:
                board_points = np.asarray(charuco.getChessboardCorners())[index.ravel()]
                corners[file.name] = board_points, uv.reshape(-1, 2)
            continue
        board_points = np.pad(np.asarray(board.centres_mm), ((0, 0), (0, 1))).astype(np.float32)
        if isinstance(board, Chessboard):
            size = (board.columns, board.rows)
            is_found, uv = cv2.findChessboardCornersSB(grey, size)
            if not is_found:
                is_found, uv = cv2.findChessboardCorners(grey, size)
                if is_found:
                    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
                    uv = cv2.cornerSubPix(grey, uv, (5, 5), (-1, -1), criteria)
        else:
            rows = len(np.unique(np.round(board_points[:, 1], 6)))
            size = (len(board_points) // rows, rows)
            is_found, uv = cv2.findCirclesGrid(grey, size, flags=cv2.CALIB_CB_SYMMETRIC_GRID)
        if is_found and len(uv) == len(board_points):
            corners[file.name] = board_points, uv.reshape(-1, 2)
    return {
        name: (p.astype(np.float32), uv.astype(np.float32)) for name, (p, uv) in corners.items()
    }


def by_opencv(folder: Path, entry: dict[str, Any]) -> dict[str, Any]:
    """Calibrate each camera singly by OpenCV and mrcal, with errors of held-out shots."""
    import cv2
    import numpy as np

    from trinoc.io.board_json import load_target

    board, answer = load_target(folder / "board.json"), {}
    fisheye = entry.get("lens_model") == "kannala_brandt"
    total: dict[str, Any] = {"found": 0, "detect_s": 0.0, "fit_s": 0.0}

    def held_out(shots: list[Any], fit: Any) -> float | None:
        errors = []
        for first in (0, 1):
            lens = fit(shots[first::2])
            if lens is None:
                return None
            for board_points, uv in shots[1 - first :: 2]:
                _, turn, shift = cv2.solvePnP(board_points, uv, *lens)
                turn, shift = cv2.solvePnPRefineLM(board_points, uv, *lens, turn, shift)
                image, _ = cv2.projectPoints(board_points, turn, shift, *lens)
                errors.append(image.reshape(-1, 2) - uv)
        return float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1))))

    for camera in entry["cameras"]:
        files = sorted((folder / camera).iterdir())
        start = time.process_time()
        corners = detect_by_opencv(files, board)
        total["detect_s"] += time.process_time() - start
        total["found"] += len(corners)
        sizes = {file.name: _size(file) for file in files if file.name in corners}
        image_size = max(set(sizes.values()), key=list(sizes.values()).count, default=None)
        shots = [pair for name, pair in corners.items() if sizes[name] == image_size]
        if len(shots) < 4 or fisheye:
            continue

        def fit(some: list[Any], image_size: Any = image_size) -> Any:
            board_points, uv = zip(*some, strict=True)
            try:
                _, matrix, bend, *_ = cv2.calibrateCamera(board_points, uv, image_size, None, None)
            except cv2.error:
                return None
            return matrix, bend

        start = time.process_time()
        board_points, uv = zip(*shots, strict=True)
        try:
            rms, matrix, _, _, _, sigma, *_ = cv2.calibrateCameraExtended(
                board_points, uv, image_size, None, None
            )
        except cv2.error as error:
            answer[camera] = {"error": str(error)}
            continue
        total["fit_s"] += time.process_time() - start
        answer[camera] = {
            "rms_px": rms,
            "focal": [matrix[0, 0], matrix[1, 1], *sigma.ravel()[:2].tolist()],
            "held_out_px": held_out(shots, fit),
        }
        mrcal = _by_mrcal(board, shots, image_size, matrix, held_out)
        if mrcal:
            answer[camera]["mrcal_held_out_px"], answer[camera]["mrcal_s"] = mrcal
    return {**total, "cameras": answer}


def _size(file: Path) -> tuple[int, int]:
    from trinoc.io.images import read_size_px

    return read_size_px(file)


def _by_mrcal(
    board: Any, shots: list[Any], size: tuple[int, int], matrix: Any, held_out: Any
) -> tuple[float | None, float] | None:
    import shutil

    import numpy as np
    from rig_parts.mrcal import PROGRAM, calibrate_by_mrcal

    from trinoc.calib.targets.checkers import Chessboard

    if not isinstance(board, Chessboard) or shutil.which(PROGRAM) is None:
        return None
    seconds = []

    class Corners:
        def __init__(self, uv: Any) -> None:
            self.circle_index, self.centres_px = np.arange(len(uv)), uv

    def fit(some: list[Any]) -> Any:
        options = ("--focal", str(float(matrix[0, 0])))
        try:
            detections = {"cam": [Corners(uv) for _, uv in some]}
            models, spent = calibrate_by_mrcal(board, detections, size, 5, options)  # pyright: ignore
        except SystemExit:
            return None
        seconds.append(spent)
        fx, fy, cx, cy, *bend = models["cam"]["intrinsics"]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.array(bend)

    return held_out(shots, fit), float(np.mean(seconds or [np.nan]))


def run_worker(project: Path, mode: str, folder: Path, entry: dict[str, Any]) -> dict[str, Any]:
    """Run one set in its own process. The result has its processor time, memory and stderr."""
    environment = {"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONPATH": str(project)}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            [sys.executable, __file__, str(folder), "--worker", mode],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, env=environment,
        )  # fmt: skip
        try:
            out, _ = process.communicate(json.dumps(entry).encode(), timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            out, _ = process.communicate()
        errors.seek(0)
        stderr = errors.read().decode(errors="replace")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    lines = out.decode(errors="replace").strip().splitlines()
    try:
        answer = json.loads(lines[-1])
    except (IndexError, json.JSONDecodeError):
        answer = {"status": "DIED", "error": stderr[-400:]}
    answer["cpu_s"] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    answer["warnings"] = [line for line in stderr.splitlines() if "Warning" in line]
    return answer


def worker(folder: Path, mode: str) -> None:
    """Calibrate one set in the child process, and write the result to standard output."""
    entry = json.loads(sys.stdin.read())
    answer = (by_trinoc if mode == "trinoc" else by_opencv)(folder, entry)
    answer["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print("\n" + json.dumps(answer))


def row(name: str, ours: dict[str, Any], theirs: dict[str, Any]) -> list[str]:
    """The cells of one set."""

    def number(value: float | None, digits: int = 3) -> str:
        return "-" if value is None or value != value else f"{value:.{digits}f}"

    cameras = theirs.get("cameras", {})
    deviations = []
    for camera, our_focal in ours.get("focal", {}).items():
        their_focal = cameras.get(camera, {}).get("focal")
        if their_focal is None:
            continue
        for k in (0, 1):
            deviations.append(
                (our_focal[k] - their_focal[k])
                / (our_focal[k + 2] ** 2 + their_focal[k + 2] ** 2) ** 0.5
            )
    held_out_px = [c["held_out_px"] for c in cameras.values() if c.get("held_out_px")]
    mrcal = [c["mrcal_held_out_px"] for c in cameras.values() if c.get("mrcal_held_out_px")]
    spent = [c["mrcal_s"] for c in cameras.values() if c.get("mrcal_s")]
    our_held_out_px = ours.get("held_out_px")
    return [
        name,
        f"{ours.get('found', 0)}/{ours.get('images', '?')}",
        str(theirs.get("found", "-")),
        ours["status"] + ("" if not ours.get("readable") else ", NOT READABLE"),
        number(ours.get("weighted_rms_px")),
        number(our_held_out_px[0] if our_held_out_px else None),
        number(max(held_out_px, default=None)),
        number(max(mrcal, default=None)),
        number(max(ours.get("sigma_factor", {}).values(), default=None), 2),
        number(ours.get("halves"), 2),
        number(max(deviations, key=abs, default=None), 1),
        number(ours.get("cpu_s"), 1),
        number(ours.get("peak_mb"), 0),
        number(theirs.get("detect_s"), 1),
        number(theirs.get("fit_s"), 2),
        number(sum(spent) if spent else None, 1),
        str(len(ours.get("warnings", ()))),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=())
    parser.add_argument("--aside", action="store_true")
    parser.add_argument("--project", type=Path, default=HERE.parent)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--no-opencv", action="store_true")
    parser.add_argument("--worker")
    options = parser.parse_args()
    if options.worker:
        worker(options.folder, options.worker)
        return
    entries = tomllib.loads((HERE / "public_sets.toml").read_text(encoding="utf-8"))["set"]
    print("\t".join(COLUMNS), flush=True)
    for entry in entries:
        name = entry["name"]
        is_wanted = name in options.only if options.only else entry["aside"] == options.aside
        folder = options.folder / name
        if not is_wanted:
            continue
        if "board" not in entry:
            print(f"{name}\tno layout of trinoc describes its board", flush=True)
            continue
        if not (folder / "board.json").exists():
            print(f"{name}\tnot there", flush=True)
            continue
        ours = run_worker(options.project.resolve(), "trinoc", folder, entry)
        theirs = {} if options.no_opencv else run_worker(HERE.parent, "opencv", folder, entry)
        print("\t".join(row(name, ours, theirs)), flush=True)
        if "error" in ours:
            print(f"    {ours['error'][:300]}", flush=True)
        if options.out:
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"set": name, "trinoc": ours, "opencv": theirs}) + "\n")


if __name__ == "__main__":
    main()
