"""Recordings: frames per second, memory over many frames, and kills at random moments.

    python benchmarks/batch_frames.py                          # 240 and 10,000 frames, 50 kills
    python benchmarks/batch_frames.py --frames 48 --many 500 --kills 5

The frames are made: segments of boxes that lie before Table 1's rig, as CSV, and for the rates also
pictures of such boxes at 512 x 480 px. Rates are of the whole job with files read and written,
kernels compiled before; the plain loop calls `find_segments`, `match_segments` and `save` for each
frame. Each kill is a kill -9 of `trinoc batch` at a random moment of its run; in the end the output
is compared, byte for byte, with that of a run that nobody killed.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import trinoc
from trinoc.io import read_image
from trinoc.synth import table1_rig

RIG = table1_rig()
BOX_MM = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)], dtype=float)
PAIRS = np.array([(a, b) for a in range(8) for b in range(a)])
EDGES = PAIRS[(BOX_MM[PAIRS[:, 0]] != BOX_MM[PAIRS[:, 1]]).sum(axis=1) == 1]


def edges_mm(generator: np.random.Generator, boxes: int) -> np.ndarray:
    """(n, 2, 3) edges of boxes of many sizes, at random positions on the sheet."""
    sizes = generator.uniform(8, 30, (boxes, 1, 3))
    offsets_mm = np.concatenate(
        [generator.uniform(-60, 60, (boxes, 1, 2)), np.zeros((boxes, 1, 1))], 2
    )
    return (BOX_MM * sizes + offsets_mm)[:, EDGES].reshape(-1, 2, 3)


def ends_px(camera: trinoc.Camera, edges: np.ndarray) -> np.ndarray:
    homogeneous = np.concatenate([edges, np.ones((*edges.shape[:2], 1))], 2) @ camera.matrix_px.T
    return homogeneous[..., :2] / homogeneous[..., 2:]


def make_segments(folder: Path, frames: int, boxes: int) -> None:
    """Tables of segments with .3 px of noise."""
    folder.mkdir(parents=True)
    generator = np.random.default_rng(16)
    for k in range(frames):
        edges = edges_mm(generator, boxes)
        for name, camera in RIG.items():
            ends = ends_px(camera, edges)
            ends = ends + generator.normal(0, 0.3, ends.shape)
            np.savetxt(
                folder / f"{k:05d}_{name}.csv", ends.reshape(-1, 4), delimiter=",", fmt="%.3f"
            )


def make_pictures(folder: Path, frames: int, boxes: int) -> None:
    """Grey pictures of the edges, drawn 3 px wide, with noise of 2 levels."""
    folder.mkdir(parents=True)
    generator = np.random.default_rng(17)
    for k in range(frames):
        edges = edges_mm(generator, boxes)
        for name, camera in RIG.items():
            width, height = camera.image_size_px
            picture = np.full((height, width), 180, dtype=np.uint8)
            for (u, v), (p, q) in ends_px(camera, edges):
                ends = [(round(16 * x), round(16 * y)) for x, y in ((u, v), (p, q))]
                cv2.line(picture, *ends, 60, 3, cv2.LINE_AA, 4)
            noisy = picture + generator.normal(0, 2, picture.shape)
            cv2.imwrite(str(folder / f"{k:05d}_{name}.png"), noisy.clip(0, 255).astype(np.uint8))


def plain_loop(frames: Path, out: Path) -> int:
    """Match the frames by the loop that a user would write. Returns the number of frames."""
    out.mkdir()
    names = sorted({path.name.rsplit("_", 1)[0] for path in frames.iterdir()})
    for name in names:
        segments = {}
        for view in RIG:
            picture, table = (frames / f"{name}_{view}.{suffix}" for suffix in ("png", "csv"))
            segments[view] = (
                trinoc.find_segments(read_image(picture))
                if picture.exists()
                else trinoc.load_segments(table)
            )
        trinoc.save(trinoc.match_segments(segments, RIG), out / f"{name}.npz")
    return len(names)


def rates(folder: Path, count: int) -> None:
    """Print the frames per second of each method."""
    print(f"{'frames':<20}{'way':<28}{'frames/s':>9}{'processor s/frame':>19}")
    for kind, make in (("segments", make_segments), ("pictures", make_pictures)):
        make(folder / kind, count, 6)
        for method, job in ways(folder / kind, folder / "out"):
            shutil.rmtree(folder / "out", ignore_errors=True)
            start, used = time.perf_counter(), sum(os.times()[:4])
            job()
            wall = time.perf_counter() - start
            used = (sum(os.times()[:4]) - used) / count
            if method:
                print(f"{kind:<20}{method:<28}{count / wall:>9.2f}{used:>19.3f}", flush=True)


def ways(frames: Path, out: Path) -> Iterator[tuple[str, Callable[[], object]]]:
    """Name and job of each method. A job without a name only compiles, and is not timed."""
    from distributed import LocalCluster

    def batch(**options: Any) -> Callable[[], object]:
        return partial(trinoc.match_recording, frames, RIG, out, ending=".npz", **options)

    yield "", batch()
    yield "plain loop", partial(plain_loop, frames, out)
    yield "threads, 1", batch(threads_at_most=1)
    yield "threads, 2", batch(threads_at_most=2)
    yield "processes, 2", batch(threads_at_most=2, in_processes=True)
    # The processor time of the workers is not in this process's count until they end.
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield "", batch(scheduler=cluster.scheduler_address)
        yield "LocalCluster, 2 workers", batch(scheduler=cluster.scheduler_address)


def resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def memory(folder: Path, count: int) -> None:
    """Print memory, threads and handles of the process while it matches frames."""
    make_segments(folder / "many", count, 1)
    print(f"\n{'frames done':>12}{'MiB':>8}{'threads':>9}{'handles':>9}")
    steps = set(np.linspace(0, count, 11).astype(int) // 16 * 16) | {count}

    def tell(progress: Any) -> None:
        if progress.done in steps:
            handles = len(os.listdir("/proc/self/fd"))
            row = f"{progress.done:>12}{resident_mib():>8.0f}{threading.active_count():>9}"
            print(f"{row}{handles:>9}", flush=True)

    options: Any = {"threads_at_most": 2, "ending": ".npz", "on_progress": tell}
    trinoc.match_recording(folder / "many", RIG, folder / "out-many", **options)


def contents(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in out.iterdir()}


def kills(folder: Path, count: int, frames: int) -> bool:
    """Kill a run `count` times. True if its output then equals that of an undisturbed run."""
    make_segments(folder / "killed", frames, 1)
    trinoc.save(RIG, folder / "rig.json")
    command = [sys.executable, "-m", "trinoc", "batch", str(folder / "killed")]
    command += ["--rig", str(folder / "rig.json"), "--frames-per-file", "2", "--quiet", "-o"]
    start = time.perf_counter()
    subprocess.run([*command, str(folder / "whole")], check=True, stdout=subprocess.DEVNULL)
    print(f"\na run that nobody kills: {time.perf_counter() - start:.0f} s", flush=True)
    out, draw, done, differing_runs, swept = folder / "broken", random.Random(16), 0, 0, 0
    before: set[str] = set()
    while done < count:
        process = subprocess.Popen([*command, str(out)], stdout=subprocess.DEVNULL)
        # The moment: while files come, counted from the first that comes.
        wanted = time.perf_counter() + 120
        file_count = len(before)
        while process.poll() is None and time.perf_counter() < wanted:
            if out.exists() and len(list(out.glob("matches-*"))) > file_count:
                break
            time.sleep(0.002)
        time.sleep(draw.random() * 0.15)
        process.send_signal(signal.SIGKILL)
        if process.wait() != -signal.SIGKILL:  # it was done: begin anew
            differing_runs += contents(out) != contents(folder / "whole")
            shutil.rmtree(out)
            before = set()
            continue
        done += 1
        files = {path.name for path in out.glob("matches-*")}
        swept += len(list(out.glob(".*.tmp")))
        if before - files:
            print(f"LOST {before - files}")
            return False
        before = files
    subprocess.run([*command, str(out)], check=True, stdout=subprocess.DEVNULL)
    same = contents(out) == contents(folder / "whole") and not differing_runs
    verdict = "equal" if same else "DIFFERENT"
    print(f"{done} kills -9, {swept} scratch files seen after them: output {verdict}")
    return same


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument("--many", type=int, default=10_000)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--only", choices=("rates", "memory", "kills"))
    options = parser.parse_args()
    good = True
    with tempfile.TemporaryDirectory() as name:
        if options.only in (None, "rates"):
            rates(Path(name), options.frames)
        if options.only in (None, "memory"):
            memory(Path(name), options.many)
        if options.only in (None, "kills"):
            good = kills(Path(name), options.kills, frames=4 * options.kills)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
