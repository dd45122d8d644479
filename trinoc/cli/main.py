"""The `trinoc` command: reads the command line, runs one command, prints what it says.

Exit status 0: done. 1: the job failed, and one sentence on stderr says why and what to do
next. 2: wrong usage. 130: interrupted. 141: nobody read the output to its end.
"""

import errno
import importlib.metadata
import json
import os
import platform
import shlex
import sys
from collections.abc import Sequence
from typing import Annotated, Any, Union

import tyro

from trinoc.cli.batch import BatchCommand
from trinoc.cli.calibrate import CalibrateCommand
from trinoc.cli.calibrate_rig import CalibrateRigCommand
from trinoc.cli.command import (
    LOGGER,
    Command,
    UsageError,
    expect_numbers,
    expect_places,
)
from trinoc.cli.demo import DemoCommand
from trinoc.cli.evaluate import EvaluateCommand
from trinoc.cli.export import ExportCommand
from trinoc.cli.intrinsics import IntrinsicsCommand, UndistortCommand
from trinoc.cli.match import MatchCommand
from trinoc.cli.pattern import PatternCommand
from trinoc.cli.refine import CheckCommand, CompareCommand, RefineCommand
from trinoc.cli.segments import SegmentsCommand
from trinoc.cli.settings import put_files_first, with_file
from trinoc.cli.watch import WatchCommand
from trinoc.errors import TrinocError

LIBRARIES = (
    *("numpy", "scipy", "jax", "jaxlib", "equinox", "optimistix", "lineax"),
    *("opencv-python-headless", "scikit-image", "tyro", "jinja2"),
)
EXTRAS = {
    "print": ("reportlab",),
    "plot": ("matplotlib",),
    "notebook": ("pandas",),
    "batch": ("dask", "distributed"),
    "export": ("ruamel.yaml",),
    "parquet": ("pyarrow",),
}
# All of these install the module cv2, each over the others.
OPENCV = (
    *("opencv-python", "opencv-python-headless", "opencv-contrib-python"),
    "opencv-contrib-python-headless",
)


def installation() -> tuple[str, list[str]]:
    """(what is installed, a line each; what to do where that is not well)."""
    import jax

    import trinoc
    from trinoc.io.compile_cache import COMPILE_CACHE_VARIABLE, enable_compile_cache

    found = {"python": f"{platform.python_version()} on {platform.platform()}"}
    found |= {name: _version(name) or "not installed" for name in LIBRARIES}
    for extra, names in EXTRAS.items():
        missing = [name for name in names if _version(name) is None]
        found[f"extra {extra}"] = f"pip install 'trinoc[{extra}]'" if missing else "installed"
    found["devices"] = ", ".join(f"{d.platform} {d.device_kind}" for d in jax.devices())
    folder = enable_compile_cache()
    off = os.environ.get(COMPILE_CACHE_VARIABLE, "").lower() in ("off", "0", "no")
    found["compile cache"] = str(folder or ("off" if off else "cannot be used"))

    remedies = [
        f"pip install {name}"
        for name in LIBRARIES
        if found[name] == "not installed" and name not in OPENCV
    ]
    wheels = [name for name in OPENCV if _version(name) is not None]
    if len(wheels) > 1:
        remedies.append(
            f"{len(wheels)} wheels bring cv2: pip uninstall -y {' '.join(wheels)} && pip install "
            "opencv-python-headless"
        )
    if folder is None and not off:
        remedies.append(f"set {COMPILE_CACHE_VARIABLE} to a folder that only you can write to")
    width = max(map(len, found))
    lines = [f"{name:<{width}}  {words}" for name, words in found.items()]
    return "\n".join([f"trinoc {trinoc.__version__}", *lines]), remedies


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def compile_quickly() -> None:
    """Choose the quicker of XLA's code generators, and processors, unless the environment does.

    A GPU gives the same tracks in the same time, but programs take twice as long to compile for it,
    and a command again 13.6 s instead of 5.3.
    """
    from trinoc.numerics.compiler_options import quick_compiling

    own = os.environ.get("XLA_FLAGS", "")
    flags = [
        f"--{name}={str(value).lower()}"
        for name, value in quick_compiling().items()
        if name not in own
    ]
    if flags:
        os.environ["XLA_FLAGS"] = " ".join([*flags, own]).rstrip()
    os.environ.setdefault("JAX_PLATFORMS", "cpu")


DESCRIPTION = (
    "Calibrate fixed cameras from one picture of a printed sheet each, and match line segments "
    "across their pictures into 3-D segments with error bars. `trinoc COMMAND --help` explains a "
    "command, `trinoc --version` says which trinoc this is and what it stands on."
)

COMMANDS: dict[str, type[Command]] = {
    "demo": DemoCommand,
    "pattern": PatternCommand,
    "watch": WatchCommand,
    "intrinsics": IntrinsicsCommand,
    "calibrate": CalibrateCommand,
    "calibrate-rig": CalibrateRigCommand,
    "segments": SegmentsCommand,
    "match": MatchCommand,
    "batch": BatchCommand,
    "refine": RefineCommand,
    "check": CheckCommand,
    "compare": CompareCommand,
    "undistort": UndistortCommand,
    "evaluate": EvaluateCommand,
    "export": ExportCommand,
}
AnyCommand: Any = Union[  # noqa: UP007, tyro reads a union that is made here
    tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in COMMANDS.items())
]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments == ["--version"]:
        said, remedies = installation()
        print(said)
        for remedy in remedies:
            print(f"trinoc: {remedy}.", file=sys.stderr)
        return 1 if remedies else 0
    if arguments and arguments[0] in COMMANDS:
        kind = COMMANDS[arguments[0]]
        arguments = [arguments[0], *put_files_first(kind, arguments[1:])]
    try:
        arguments = with_file(arguments)
    except UsageError as error:
        print(f"trinoc: {error}", file=sys.stderr)
        return 2
    try:
        command = tyro.cli(
            AnyCommand,
            prog="trinoc",
            description=DESCRIPTION,
            args=arguments,
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
        )
    except SystemExit as exit_:  # tyro prints help or what is wrong by itself
        return int(exit_.code or 0)
    return _run(command, shlex.join(["trinoc", *arguments]))


def _run(command: Command, command_line: str) -> int:
    # Small LAPACK calls are many times slower when their threads fight over busy cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from trinoc.cli.command import set_up_logging
    from trinoc.cli.main import compile_quickly
    from trinoc.io.compile_cache import enable_compile_cache

    set_up_logging(quiet=command.quiet)
    if sys.stderr.isatty():  # a person waits
        LOGGER.info("loading")
    compile_quickly()
    enable_compile_cache()
    try:
        expect_numbers(command)
        expect_places(command)
        outcome = command.run(command_line).with_files()
    except TrinocError as error:
        return _report_failure(
            command, str(error), status=2 if isinstance(error, UsageError) else 1
        )
    except BrokenPipeError:
        raise
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        is_long = error.errno == errno.ENAMETOOLONG
        remedy = "give a shorter name" if is_long else "check the disk"
        return _report_failure(command, f"{place}{error.strerror or error}: {remedy}.", status=1)
    except MemoryError:
        return _report_failure(
            command, "The memory does not suffice: give smaller or fewer files.", 1
        )
    except KeyboardInterrupt as stopped:
        said = str(stopped) or "Interrupted: files that were not finished are not there."
        return _report_failure(command, said, 130)
    record = outcome.record
    if outcome.refusal is not None:
        record = {**record, "error": outcome.refusal}
        print(f"trinoc: {record['error']}", file=sys.stderr)
    said = json.dumps(record, allow_nan=False) if command.json else outcome.text
    _print(said)
    return 0 if outcome.refusal is None else 1


def _print(text: str) -> None:
    """To stdout, with a question mark for what its encoding lacks."""
    if sys.stdout is None:  # closed
        return
    encoding = sys.stdout.encoding or "utf-8"
    print(text.encode(encoding, errors="replace").decode(encoding))


def _report_failure(command: Command, sentence: str, status: int) -> int:
    # Names of files and cameras may hold anything; what is said stays one line.
    sentence = " ".join(sentence.splitlines())
    print(f"trinoc: {sentence}", file=sys.stderr)
    if command.json:
        _print(json.dumps({"error": sentence}))
    return status
