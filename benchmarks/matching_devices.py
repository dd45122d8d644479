"""Matching on each device of JAX against the CPU: time, peak memory, equality of the results.

    python benchmarks/matching_devices.py [--counts 500 2000] [--frames 200] [--once]

Loose segments at four times the resolution of the paper's pictures, as in `matching.py`; --counts
are lines in space, of which each view shows about 1.4 segments. With --once nothing is run warm,
for counts that take minutes (14600 gives 20,000 segments per view).
"""

import argparse
import resource
import time
from collections.abc import Callable

import jax
import numpy as np
from matching import FRESH_SEED

from simulation import Detector, loose_segments, simulate_segments
from trinoc.match import match_many
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches
from trinoc.synth import table1_rig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[500, 2000])
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--once", action="store_true")
    options = parser.parse_args()
    devices = [*jax.devices("cpu")[:1], *(d for d in jax.devices() if d.platform != "cpu")]
    print(f"devices: {', '.join(f'{d.platform} {d.device_kind}' for d in devices)}")
    rig = table1_rig(resolution=4)
    for count in options.counts:
        scene = loose_segments(FRESH_SEED + 500, count=count)
        segments, _ = simulate_segments(scene, rig, Detector(shortest_px=32.0), seed=FRESH_SEED)
        answers = []
        for device in devices:
            with jax.default_device(device):
                line, matches = _timed(lambda: match_segments(segments, rig), options.once)  # noqa: B023
            answers.append(matches)
            print(f"{len(segments['upper']):6d} per view, {device.platform}: {line}", flush=True)
        _compare(answers)
    if options.frames:
        frames = [
            simulate_segments(
                loose_segments(seed, count=75), rig, Detector(shortest_px=32.0), seed=seed
            )[0]
            for seed in range(FRESH_SEED, FRESH_SEED + options.frames)
        ]
        for device in devices:
            with jax.default_device(device):
                line, _ = _timed(lambda: match_many(frames, rig), options.once)
            print(f"{options.frames} frames, {device.platform}: {line}", flush=True)


def _timed(call: Callable[[], Matches], once: bool) -> tuple[str, Matches]:
    matches, *first = _seconds(call)
    line = "first {:.2f} s ({:.2f} s of processor)".format(*first)
    if not once:
        rows = [_seconds(call)[1:] for _ in range(3)]
        line += ", warm {:.3f} s ({:.3f} s of processor)".format(*np.median(rows, axis=0))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return f"{line}, peak memory so far {peak:.0f} MiB", matches


def _seconds(call: Callable[[], Matches]) -> tuple[Matches, float, float]:
    """(result of the call, wall-clock seconds, processor seconds)."""
    wall, processor = time.perf_counter(), time.process_time()
    result = call()
    return result, time.perf_counter() - wall, time.process_time() - processor


def _compare(answers: list[Matches]) -> None:
    first = {tuple(row) for row in answers[0].index.tolist()}
    for other in answers[1:]:
        same = first & {tuple(row) for row in other.index.tolist()}
        print(f"       tracks of both {len(same)}, of the CPU {len(first)}, of this {len(other)}")


if __name__ == "__main__":
    main()
