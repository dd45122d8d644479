"""Test that the tests fail if a covariance, a prior or a weight is wrong.

    python benchmarks/mutations.py [--only WORD ...] [--jobs 2]

Each place of `mutations.toml` is broken in a copy of the checkout, one at a time, and the tests
nearest to it are run, which pass first as the checkout stands. A mutation that they pass has
survived: a law is missing. Prints a row for each, with seconds and the file of tests that noticed
(name it first among the place's tests: they stop there), the survivors last; exits 1 where there
are any. Bytecode and programs that a mutation leaves as they are are made once.
A place that is no longer in its file, or is there more than once, is reported as lost; one whose
tests took more than LIMIT_S, as late.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent
LIMIT_S = 600
COPIED = (
    *("trinoc", "simulation", "tests", "benchmarks", "docs", "patterns"),
    *("pyproject.toml", "README.md"),
)


class Mutation(NamedTuple):
    """A text of a file and its wrong replacement.

    Fields
    ------
    what : in words. file : below `trinoc`. before, after : text; `before` is there once.
    tests : files or folders below `tests`.
    """

    what: str
    file: str
    before: str
    after: str
    tests: Sequence[str]


def places() -> list[Mutation]:
    """All listed mutations."""
    with (HERE / "mutations.toml").open("rb") as file:
        listed = tomllib.load(file)["mutation"]
    return [Mutation(**entry) for entry in listed]


class Outcome(NamedTuple):
    """Result of the tests of one mutation.

    Fields
    ------
    status : of pytest, None where it took too long. noticed : the file whose test failed, or "".
    """

    status: int | None
    noticed: str


def run_tests(
    copy: Path, tests: Sequence[str], limit_s: float | None = LIMIT_S, jobs: int = 0
) -> Outcome:
    """Run pytest in a copy of the checkout, up to the first failure."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", f"-n{jobs}", "-p", "no:cacheprovider"]
    command += ["-m", "not slow", *(f"tests/{path}" for path in tests)]
    environment = {
        **os.environ,
        "PYTHONPATH": str(copy),
        "OMP_NUM_THREADS": "1",
        "JAX_COMPILATION_CACHE_DIR": str(copy.parent / "compiled"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        "PYTHONPYCACHEPREFIX": str(copy.parent / "bytecode"),
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    try:
        ended = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, check=False, timeout=limit_s
        )
    except subprocess.TimeoutExpired:
        return Outcome(None, "")
    failed = re.search(r"^(?:FAILED|ERROR) tests/([^\s:]+)", ended.stdout.decode(), re.MULTILINE)
    return Outcome(ended.returncode, failed[1] if failed else "")


def outcome(mutation: Mutation, copies: list[Path]) -> tuple[str, str]:
    """ "caught", "survived", "late" or "lost" and who noticed, in one of the copies, which is left
    as it was."""
    copy = copies.pop()
    path = copy / "trinoc" / mutation.file
    source = path.read_text()
    try:
        if source.count(mutation.before) != 1:
            return "lost", ""
        path.write_text(source.replace(mutation.before, mutation.after))
        start = time.perf_counter()
        status, noticed = run_tests(copy, mutation.tests)
        noticed = f"{time.perf_counter() - start:.0f} s {noticed}"
        # 1 : tests failed; 2 and 4 : the file does not even import.
        end = "late" if status is None else "caught" if status in (1, 2, 4) else "survived"
        return end, noticed
    finally:
        path.write_text(source)
        copies.append(copy)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="words of files or descriptions")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    mutations = [
        mutation
        for mutation in places()
        if not options.only
        or any(word in f"{mutation.file} {mutation.what}" for word in options.only)
    ]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.jobs) as pool:
        copies = [Path(folder) / str(k) for k in range(options.jobs)]
        for copy in copies:
            copy.mkdir()
            for name in COPIED:
                source = CHECKOUT / name
                (shutil.copytree if source.is_dir() else shutil.copy)(source, copy / name)
        nearest = sorted({test for mutation in mutations for test in mutation.tests})
        if run_tests(copies[0], nearest, None, options.jobs).status:
            print("The tests fail without any mutation: mend them first.")
            return 1
        ends = []
        outcomes = pool.map(lambda m: outcome(m, copies), mutations)
        for mutation, (end, noticed) in zip(mutations, outcomes, strict=True):
            print(f"{end:9} {mutation.file:42} {mutation.what}: {noticed}", flush=True)
            ends.append(end)
    wrong = [mutation for mutation, end in zip(mutations, ends, strict=True) if end != "caught"]
    print(f"\n{len(mutations)} places, {len(wrong)} not caught")
    for mutation in wrong:
        print(f"  {mutation.file}: {mutation.what}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
