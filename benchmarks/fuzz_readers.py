"""Every reader under a coverage-guided fuzzer (atheris), from valid files.

    pip install atheris && python benchmarks/fuzz_readers.py [--seconds 20] [--only NAME]

A row is a reader: inputs tried, and failures that are none of trinoc's typed errors, each counted
once by its type and place. Exits with 1 if there are any. The fuzzer sees the branches of trinoc
itself; libraries below it (OpenCV, Arrow) are not instrumented.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

ROOT = Path(__file__).parents[1]


def fuzz(kind: str, folder: Path, seconds: int) -> None:
    """Fuzz one reader. Never returns: the fuzzer ends the process."""
    import atheris

    sys.path.insert(0, str(ROOT))
    with atheris.instrument_imports(include=["trinoc"]):
        import trinoc.io  # noqa: F401
        from tests.io.valid_files import valid_files
        from trinoc.errors import TrinocError

        file = valid_files(folder / "valid")[kind]
    file.load()
    corpus = folder / "corpus"
    corpus.mkdir()
    (corpus / "valid").write_bytes(file.path.read_bytes())
    failure_names: set[str] = set()

    def try_one(content: bytes) -> None:
        file.path.write_bytes(content)
        try:
            file.load()
        except TrinocError as error:
            if "\n" in str(error):
                note(f"two lines: {error!r}")
        except Exception as error:
            frames = traceback.extract_tb(error.__traceback__)
            frame = [f for f in frames if f"{os.sep}trinoc{os.sep}" in f.filename][-1]
            note(f"{type(error).__name__} in {Path(frame.filename).name}:{frame.lineno}: {error}")

    def note(failure: str) -> None:
        name = re.sub(r":\s.*", "", failure.splitlines()[0])
        if name not in failure_names:
            failure_names.add(name)
            print(f"FAILURE {failure[:200]!r}", flush=True)

    options = [f"-max_total_time={seconds}", "-max_len=60000", "-rss_limit_mb=4000", "-timeout=20"]
    atheris.Setup(
        [sys.argv[0], str(corpus), *options, "-verbosity=0", "-print_final_stats=1"], try_one
    )
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--only")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        fuzz(options.child, Path(os.environ["FUZZ_FOLDER"]), options.seconds)
    try:
        import atheris  # noqa: F401
    except ImportError:
        print("atheris is not installed: pip install atheris", file=sys.stderr)
        return 2
    sys.path.insert(0, str(ROOT))
    from tests.io.valid_files import valid_files

    with tempfile.TemporaryDirectory() as name:
        kinds = [options.only] if options.only else list(valid_files(Path(name)))
    inputs, failures = 0, 0
    print(f"{'reader':<28}{'inputs':>10}{'failures':>10}", flush=True)
    for kind in kinds:
        with tempfile.TemporaryDirectory() as name:
            done = subprocess.run(
                [sys.executable, __file__, "--child", kind, "--seconds", str(options.seconds)],
                env={**os.environ, "FUZZ_FOLDER": name},
                cwd=name,
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
            )
        tried = re.search(r"number_of_executed_units:\s*(\d+)", done.stdout + done.stderr)
        failure_lines = [line for line in done.stdout.splitlines() if line.startswith("FAILURE")]
        if not tried or done.returncode != 0:
            failure_lines.append(
                f"FAILURE the process ended with {done.returncode}: {done.stderr[-300:]!r}"
            )
        inputs += int(tried[1]) if tried else 0
        failures += len(failure_lines)
        print(f"{kind:<28}{tried[1] if tried else '?':>10}{len(failure_lines):>10}", flush=True)
        for line in failure_lines:
            print(f"    {line}", flush=True)
    spent = options.seconds * len(kinds)
    print(f"{inputs} inputs in {spent} s, {len(kinds)} readers: {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
