"""Programs that a command compiles: their number, size and time.

    python benchmarks/programs.py [--programs 30] [--operations 56000] [-- COMMAND ARGUMENT ...]

Runs a command (by default `trinoc demo`) in a fresh process with an empty compile cache, then
again, then without a cache, where JAX writes what it compiles. A row for each program says how
often it was compiled, its operations in StableHLO, and its seconds of tracing, lowering and
compiling in the first run, by the clock, which overlap where several threads compile. The last
lines say seconds of processor and clock, and the peak of memory, of the first run and the second.
Ends with 1 where there are more programs or operations than the budget: these do not depend on the
machine. Times do: compare ratios.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

COMMAND = ("demo", "--quiet", "--out", "demo")
CHILD = """
import collections, json, resource, sys, time
start = time.perf_counter()
import jax.monitoring
seconds = collections.defaultdict(float)
jax.monitoring.register_event_duration_secs_listener(
    lambda event, duration, **more: seconds.__setitem__(
        key := f"{event.rsplit('/', 1)[-1]} {more.get('fun_name', '')}", seconds[key] + duration
    )
)
from trinoc.cli.main import main
status = main(sys.argv[2:])
used = resource.getrusage(resource.RUSAGE_SELF)
told = {
    "seconds": seconds, "status": status, "clock": time.perf_counter() - start,
    "processor": used.ru_utime + used.ru_stime, "mib": used.ru_maxrss / 1024,
}
open(sys.argv[1], "w").write(json.dumps(told))
"""
STAGES = {
    "jaxpr_trace_duration": "trace",
    "jaxpr_to_mlir_module_duration": "lower",
    "backend_compile_duration": "compile",
}


def run_command(arguments: list[str], folder: Path, environment: dict[str, str]) -> dict:
    """Report of one fresh process."""
    report_file = folder / "told.json"
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(report_file), *arguments],
        env=os.environ | environment,
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode or not report_file.exists():
        sys.exit(done.stderr)
    return json.loads(report_file.read_text())


def plain_name(name: str) -> str:
    """A program's name without `jit` and the token that distinguishes equal names."""
    name = re.sub(r"^jit[_(](.*?)\)?$", r"\1", name)
    return re.sub(r"_[0-9a-f]{8}$", "", name)


def operations(dump: Path) -> tuple[Counter[str], Counter[str]]:
    """(how often each program was compiled, its operations in all)."""
    compiled: Counter[str] = Counter()
    size: Counter[str] = Counter()
    for file in sorted(dump.glob("*.mlir")):
        match = re.match(r"jax_ir\d+_(.*)_compile", file.stem)
        name = plain_name(match[1] if match else file.stem)
        compiled[name] += 1
        size[name] += file.read_text().count(" = ")
    return compiled, size


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--programs", type=int, default=30)
    parser.add_argument("--operations", type=int, default=56_000)
    parser.add_argument("--rows", type=int, default=25)
    parser.add_argument("command", nargs="*", default=list(COMMAND))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        cache, dump = {"TRINOC_COMPILE_CACHE": str(folder / "cache")}, folder / "programs"
        first = run_command(options.command, folder, cache)
        second_run = run_command(options.command, folder, cache)
        # What is written is not taken from the cache.
        off = {"TRINOC_COMPILE_CACHE": "off", "JAX_DUMP_IR_TO": str(dump)}
        run_command(options.command, folder, off)
        compiled, size = operations(dump)
    seconds: dict[str, dict[str, float]] = defaultdict(lambda: dict.fromkeys(STAGES.values(), 0.0))
    for key, value in first["seconds"].items():
        event, name = key.split(" ", 1)
        if event in STAGES:
            seconds[plain_name(name)][STAGES[event]] += value
    print(f"{'program':34s} {'times':>5s} {'operations':>10s}  trace  lower compile (s)")
    for name, count in size.most_common(options.rows):
        row = " ".join(f"{value:6.2f}" for value in seconds[name].values())
        print(f"{name:34.34s} {compiled[name]:5d} {count:10d} {row}")
    total = {stage: sum(times[stage] for times in seconds.values()) for stage in STAGES.values()}
    row = " ".join(f"{value:6.2f}" for value in total.values())
    print(f"{'all':34s} {compiled.total():5d} {size.total():10d} {row}")
    for label, report in (("empty cache", first), ("again", second_run)):
        print(
            f"{label:12s} status {report['status']}  processor {report['processor']:.1f} s  "
            f"clock {report['clock']:.1f} s  memory {report['mib']:.0f} MiB"
        )
    if compiled.total() > options.programs or size.total() > options.operations:
        sys.exit(f"More than {options.programs} programs or {options.operations} operations.")


if __name__ == "__main__":
    main()
