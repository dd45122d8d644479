"""Time of the first call in a fresh process, and the share of compilation in it.

    python benchmarks/first_calls.py [--only CALL ...] [--runs 1] [--states full] [--against DIR]

Every call runs in processes of its own, in three states of the compile cache: "off", "empty" (an
empty folder that it fills), and "full" (the folder that the one before has filled). A row says the
processor seconds until trinoc and the inputs are there (start), of the first call with the imports
that it makes itself, and of a warm one (median of five); how many programs the first call compiled;
its seconds of tracing and lowering, and of compiling, by the clock and counted once where they
nest; and the peak of the process's memory. Processor seconds count all threads. With
--against DIR, another checkout is measured in turn in the same run (A B A B), and the ratios of its
medians to this one's are printed. Inputs are made once, by this checkout, and read from files.
Times belong to one machine and its load: compare ratios.
"""

import argparse
import json
import os
import resource
import runpy
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
STATES = ("off", "empty", "full")
WARM_CALLS = 5
CAMERAS, SHOTS = ("left", "right"), 6


def make_inputs(folder: Path) -> None:
    """Pictures, places, segments, matches and rigs of fixed seeds, as files."""
    from intrinsics import LENS, image_of, random_poses
    from picture_conditions import CONDITIONS
    from rig_parts.made import BOARDS, boards, observed

    import trinoc
    from simulation import Detector, loose_segments, simulate_segments
    from simulation.camera_picture.render import camera_picture
    from trinoc.io import demo_images, demo_pattern
    from trinoc.synth import table1_lens, table1_rig

    trinoc.io.enable_compile_cache()
    condition = CONDITIONS["vignette and broad glare"]
    camera = condition.camera(table1_lens(), (23.568, 38.616, -0.994, 472.894))
    delivered = camera_picture(trinoc.Pattern.default(), camera, condition, seed=1)
    lens = [np.rint(image_of(LENS, pose)).astype(np.uint8) for pose in random_poses(5, 5)]
    np.savez(folder / "pictures.npz", delivered=delivered, lens=np.stack(lens))
    board, sigma_px = BOARDS["chessboard"]
    detections = observed(board, sigma_px, boards(SHOTS, np.random.default_rng(0)), _random())
    shots = {}
    for name in CAMERAS:
        for shot, detection in enumerate(detections[name]):
            if detection is not None:
                shots[f"{name}.{shot}.index"] = detection.circle_index
                shots[f"{name}.{shot}.px"] = detection.centres_px
    np.savez(folder / "shots.npz", **shots)
    sheet = trinoc.calibrate(demo_images("sheet"), demo_pattern(), table1_lens(), method="points")
    trinoc.save(sheet.rig, folder / "rig.json")
    scene = {view: trinoc.find_segments(image) for view, image in demo_images("scene").items()}
    for view, segments in scene.items():
        trinoc.save(segments, folder / f"scene_{view}.npz")
    trinoc.save(trinoc.match_segments(scene, sheet.rig), folder / "matches.npz")
    many, _ = simulate_segments(
        loose_segments(900_005, count=500), table1_rig(), Detector(), seed=7
    )
    np.savez(
        folder / "many.npz", **{view: segments.endpoints_px for view, segments in many.items()}
    )


def _random() -> np.random.Generator:
    return np.random.default_rng(1)


def calibrate(_: Path) -> Callable[[], Any]:
    """Three pictures of the demo's sheet, with the typical systematics."""
    import trinoc
    from trinoc.io import demo_images, demo_pattern
    from trinoc.synth import table1_lens

    images, pattern, lens = demo_images("sheet"), demo_pattern(), table1_lens()
    return lambda: trinoc.calibrate(images, pattern, lens)


def calibrate_delivered(folder: Path) -> Callable[[], Any]:
    """One picture with vignetting and glare, which the extended model fits."""
    import trinoc
    from trinoc.synth import table1_lens

    picture = np.load(folder / "pictures.npz")["delivered"]
    pattern, lens = trinoc.Pattern.default(), table1_lens()
    return lambda: trinoc.calibrate({"a": picture}, pattern, lens)


def calibrate_rig(folder: Path) -> Callable[[], Any]:
    """Two cameras and six shots of a chessboard's corners."""
    import trinoc
    from trinoc.calib import Detection

    board = trinoc.Chessboard(rows=8, columns=8, square_mm=20.0)
    arrays = np.load(folder / "shots.npz")
    detections: dict[str, dict[str, Detection]] = {name: {} for name in CAMERAS}
    for key in arrays.files:
        name, shot, kind = key.split(".")
        if kind == "index":
            centres_px = arrays[f"{name}.{shot}.px"]
            detections[name][shot] = Detection(
                circle_index=arrays[key],
                centres_px=centres_px,
                covariance_px2=np.tile(0.01 * np.eye(2), (len(centres_px), 1, 1)),
                shape_px2=np.full((len(centres_px), 2, 2), np.nan),
                lines_px=np.full((2, 3), np.nan),
                image_size_px=(640, 480),
            )
    return lambda: trinoc.calibrate_rig(detections, board)


def calibrate_intrinsics(folder: Path) -> Callable[[], Any]:
    """Five pictures of the sheet."""
    import trinoc

    pictures = list(np.load(folder / "pictures.npz")["lens"])
    return lambda: trinoc.calibrate_intrinsics(pictures, trinoc.Pattern.default())


def refine(folder: Path) -> Callable[[], Any]:
    """The demo's rig with its prior, and the demo's matches."""
    import trinoc

    rig = trinoc.load_rig(folder / "rig.json")
    matches = trinoc.load_matches(folder / "matches.npz")
    return lambda: trinoc.refine(rig, matches)


def find_segments(_: Path) -> Callable[[], Any]:
    """One picture of the demo's scene."""
    import trinoc
    from trinoc.io import demo_images

    image = demo_images("scene")["upper"]
    return lambda: trinoc.find_segments(image)


def measure_lines(folder: Path) -> Callable[[], Any]:
    """The demo's matches in the demo's pictures."""
    import trinoc
    from trinoc.io import demo_images

    images = demo_images("scene")
    rig = trinoc.load_rig(folder / "rig.json")
    matches = trinoc.load_matches(folder / "matches.npz")
    segments = {view: trinoc.load_segments(folder / f"scene_{view}.npz") for view in images}
    return lambda: trinoc.match.measure_lines(matches, segments, rig, images)


def match_segments(folder: Path) -> Callable[[], Any]:
    """Three views of about 650 loose segments each."""
    import trinoc
    from trinoc.synth import table1_rig

    with np.load(folder / "many.npz") as file:
        segments = {view: file[view] for view in file.files}
    rig = table1_rig()
    return lambda: trinoc.match_segments(segments, rig)


def demo(_: Path) -> Callable[[], Any]:
    """`trinoc demo`, the whole job with its report."""

    def run() -> None:
        with tempfile.TemporaryDirectory() as out:
            sys.argv = ["trinoc", "demo", "--quiet", "--out", out]
            try:
                runpy.run_module("trinoc", run_name="__main__")
            except SystemExit as ended:
                if ended.code:
                    raise

    return run


CALLS = {
    call.__name__: call
    for call in (
        *(calibrate, calibrate_delivered, calibrate_rig, calibrate_intrinsics, refine),
        *(find_segments, measure_lines, match_segments, demo),
    )
}


class Compilations:
    """Programs and times that JAX reports while it traces, lowers and compiles."""

    TRACING = ("jaxpr_trace_duration", "jaxpr_to_mlir_module_duration")
    COMPILING = ("backend_compile_duration",)

    def __init__(self) -> None:
        """Start to listen to JAX."""
        import jax

        self._spans: list[tuple[str, int, float, float]] = []
        self._hits = 0
        jax.monitoring.register_event_duration_secs_listener(self._add)
        jax.monitoring.register_event_listener(self._count)

    def _add(self, event: str, seconds: float, **_: Any) -> None:
        end = time.perf_counter()
        kind = event.rpartition("/")[2]
        self._spans.append((kind, threading.get_ident(), end - seconds, end))

    def _count(self, event: str, **_: Any) -> None:
        self._hits += event == "/jax/compilation_cache/cache_hits"

    @property
    def programs(self) -> int:
        """Number of programs that were compiled and not found in JAX's cache."""
        return sum(kind in self.COMPILING for kind, *_ in self._spans) - self._hits

    def seconds(self, kinds: tuple[str, ...]) -> float:
        """Total time of all threads; nested spans count once."""
        total = 0.0
        for thread in {span[1] for span in self._spans}:
            spans = sorted(s[2:] for s in self._spans if s[0] in kinds and s[1] == thread)
            reached = -np.inf
            for start, end in spans:
                total += max(0.0, end - max(start, reached))
                reached = max(reached, end)
        return float(total)


def measure(name: str, folder: Path) -> dict[str, float]:
    """Times and memory of one call, in this process."""
    if os.environ["TRINOC_COMPILE_CACHE"] != "off":
        import trinoc

        trinoc.io.enable_compile_cache()
    call = CALLS[name](folder)
    compilations = Compilations()
    start = time.process_time()
    call()
    first = time.process_time() - start
    figures = {
        "start": start,
        "first": first,
        "programs": compilations.programs,
        "trace": compilations.seconds(Compilations.TRACING),
        "compile": compilations.seconds(Compilations.COMPILING),
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    warm = []
    for _ in range(WARM_CALLS):
        began = time.process_time()
        call()
        warm.append(time.process_time() - began)
    return {**figures, "warm": statistics.median(warm)}


def in_a_process(checkout: Path, cache: str, *arguments: str) -> str:
    """Output of this file with a checkout, in a fresh process."""
    environment = os.environ | {
        "PYTHONPATH": str(checkout),
        "TRINOC_COMPILE_CACHE": cache,
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [sys.executable, __file__, *arguments]
    done = subprocess.run(
        command, env=environment, cwd=checkout, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)} fails in {checkout}:\n{done.stderr[-3000:]}")
    return done.stdout


def rounds(options: argparse.Namespace, checkouts: list[Path], folder: Path) -> None:
    """Measure every call in turn with all checkouts, and print its rows."""
    columns = ("start", "first", "warm", "programs", "trace", "compile", "peak")
    print(f"{'call':22s} {'cache':6s} {'':8s}" + "".join(f"{column:>9s}" for column in columns))
    for name in options.only or CALLS:
        measurements: dict[tuple[str, int], list[dict[str, float]]] = {}
        for run in range(options.runs):
            for state in STATES:
                # A full cache needs an empty one to have been filled.
                if state not in options.states and (state == "off" or "full" not in options.states):
                    continue
                for number, checkout in enumerate(checkouts):
                    cache = folder / f"cache_{name}_{run}_{number}"
                    cache_setting = "off" if state == "off" else str(cache)
                    output = in_a_process(
                        checkout, cache_setting, "--measure", name, "--inputs", str(folder)
                    )
                    measurement = json.loads(output.splitlines()[-1])
                    measurements.setdefault((state, number), []).append(measurement)
        for state in options.states:
            medians = [
                {
                    column: statistics.median(
                        measurement[column] for measurement in measurements[state, number]
                    )
                    for column in columns
                }
                for number in range(len(checkouts))
            ]
            for label, row in zip(("this", "against"), medians, strict=False):
                cells = "".join(f"{row[column]:9.4g}" for column in columns)
                print(f"{name:22s} {state:6s} {label:8s}{cells}", flush=True)
            if len(medians) > 1:
                ratios = [
                    medians[1][c] / medians[0][c] if medians[0][c] else np.nan for c in columns
                ]
                cells = "".join(f"{ratio:9.2f}" for ratio in ratios)
                print(f"{'':22s} {state:6s} {'ratio':8s}{cells}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="*", default=[], choices=CALLS)
    parser.add_argument("--runs", type=int, default=1, help="processes of each kind")
    parser.add_argument("--states", nargs="*", default=list(STATES), choices=STATES)
    parser.add_argument("--checkout", type=Path, default=HERE.parent, help="this one by default")
    parser.add_argument("--against", type=Path, help="another checkout, measured in turn")
    parser.add_argument("--measure", choices=CALLS, help=argparse.SUPPRESS)
    parser.add_argument("--inputs", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(options.measure, options.inputs)))
        return
    if options.inputs:
        make_inputs(options.inputs)
        return
    checkouts = [options.checkout.resolve()]
    checkouts += [options.against.resolve()] if options.against else []
    with tempfile.TemporaryDirectory() as folder:
        # Not here: a process inherits the memory peak of the one that starts it.
        in_a_process(checkouts[0], os.environ.get("TRINOC_COMPILE_CACHE", ""), "--inputs", folder)
        print(
            f"{', against '.join(map(str, checkouts))}; processor seconds (start, first, warm), "
            "seconds (trace, compile), MiB (peak)"
        )
        rounds(options, checkouts, Path(folder))


if __name__ == "__main__":
    main()
