"""The import tree of a command or of `import trinoc; trinoc.NAME`, by cost.

    python benchmarks/imports.py [--least-ms 10] [--runs 3] [--packages] calibrate ...
    python benchmarks/imports.py [--least-ms 10] [--runs 3] [--packages] --python trinoc.calibrate

Everything behind the options is the command line of trinoc, which runs as it is typed, in the
current folder, with its output discarded. A row is a module: milliseconds until it is there with
all that it imports for the first time, and by itself; below it, further in, those that it imported.
Of several runs the least is taken, module by module. With --packages a row is a package, or a room
of trinoc: by itself, and how many of its modules there are. Times are by the clock, and belong to
one machine and its load. The last row is the sum of the modules by themselves.
"""

import argparse
import re
import subprocess
import sys
from collections import Counter

_LINE = re.compile(r"import time:\s+(\d+) \|\s+(\d+) \|( *)(\S+)")
_COMMAND = "import sys; sys.argv[0] = 'trinoc'; from trinoc.cli.program import run; run()"


def list_imports(statement: str, arguments: list[str]) -> list[tuple[int, str, float, float]]:
    """(depth, module, cumulative ms, own ms) of each import, each before its own imports."""
    command = [sys.executable, "-X", "importtime", "-c", statement, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = [match.groups() for match in map(_LINE.match, done.stderr.splitlines()) if match]
    return [
        (len(indent) // 2, module, int(cumulative) / 1e3, int(self_time) / 1e3)
        for self_time, cumulative, indent, module in reversed(rows)
    ]


def least_times(
    statement: str, arguments: list[str], runs: int
) -> list[tuple[int, str, float, float]]:
    """`list_imports` of the last run, with the least times of all runs."""
    cumulative: dict[str, float] = {}
    self_time: dict[str, float] = {}
    rows: list[tuple[int, str, float, float]] = []
    for _ in range(runs):
        rows = list_imports(statement, arguments)
        for _, module, cumulative_ms, self_ms in rows:
            cumulative[module] = min(cumulative_ms, cumulative.get(module, cumulative_ms))
            self_time[module] = min(self_ms, self_time.get(module, self_ms))
    return [(depth, module, cumulative[module], self_time[module]) for depth, module, _, _ in rows]


def package_of(module: str) -> str:
    """Package of a module; for trinoc, the subpackage."""
    parts = module.split(".")
    return ".".join(parts[: 2 if parts[0] == "trinoc" else 1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--least-ms", type=float, default=10.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--packages", action="store_true")
    parser.add_argument("--python", metavar="TRINOC.NAME")
    parser.add_argument("words", nargs=argparse.REMAINDER, metavar="COMMAND ...")
    args = parser.parse_args()
    statement = _COMMAND if args.python is None else f"import trinoc; {args.python}"
    rows = least_times(statement, args.words, args.runs)
    if args.packages:
        times, counts = Counter[str](), Counter[str]()
        for _, module, _, own_ms in rows:
            times[package_of(module)] += own_ms  # pyright: ignore[reportArgumentType]
            counts[package_of(module)] += 1
        for package, own_ms in times.most_common():
            if own_ms >= args.least_ms:
                print(f"{own_ms:8.1f} ms  {package} ({counts[package]})")
    else:
        for depth, module, whole_ms, own_ms in rows:
            if whole_ms >= args.least_ms:
                print(f"{whole_ms:8.1f} {own_ms:8.1f} ms  {'  ' * depth}{module}")
    print(f"{sum(own_ms for *_, own_ms in rows):8.1f} ms  {len(rows)} modules")


if __name__ == "__main__":
    main()
