"""The `trinoc` command: reads the command line, runs one command, prints what it says.

Exit status 0: done. 1: the job failed, and one sentence on stderr says why and what to do
next. 2: wrong usage. 130: interrupted. 141: nobody read the output to its end.
"""

import json
import os
import shlex
import sys
from collections.abc import Sequence
from typing import Annotated, Any, Union

import tyro

from trinoc.cli.batch import Batch
from trinoc.cli.calibrate import Calibrate
from trinoc.cli.calibrate_rig import CalibrateRig
from trinoc.cli.check import Check
from trinoc.cli.command import Command, UsageError
from trinoc.cli.demo import Demo
from trinoc.cli.evaluate import Evaluate
from trinoc.cli.export import Export
from trinoc.cli.installation import installation
from trinoc.cli.intrinsics import Intrinsics
from trinoc.cli.match import Match
from trinoc.cli.numbers import expect_numbers
from trinoc.cli.pattern import Pattern
from trinoc.cli.places import expect_places
from trinoc.cli.refine import Refine
from trinoc.cli.rig_toml import with_file
from trinoc.cli.segments import Segments
from trinoc.cli.view import View
from trinoc.cli.watch import Watch
from trinoc.cli.words import in_options
from trinoc.errors import TrinocError

DESCRIPTION = (
    "Calibrate fixed cameras from one picture of a printed sheet each, and match line segments "
    "across their pictures into 3-D segments with error bars. `trinoc COMMAND --help` explains a "
    "command, `trinoc --version` says which trinoc this is and what it stands on."
)

COMMANDS: tuple[type[Command], ...] = (
    *(Demo, Pattern, Watch, Intrinsics, Calibrate, CalibrateRig, Segments, Match, Batch, Refine),
    *(Check, Evaluate, View, Export),
)
AnyCommand: Any = Union[  # noqa: UP007, tyro reads a union that is made here
    tuple(Annotated[each, tyro.conf.subcommand(each.command_name())] for each in COMMANDS)
]
# What commands of before are typed as now.
_NOW = {
    "doctor": "trinoc --version",
    "import": "trinoc export FILE --from FORMAT -o OUT",
    "wireframe": "trinoc match ... --steps wireframe",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments == ["--version"]:
        said, remedies = installation()
        print(said)
        for remedy in remedies:
            print(f"trinoc: {remedy}.", file=sys.stderr)
        return 1 if remedies else 0
    if arguments and arguments[0] in _NOW:
        print(f"trinoc: {arguments[0]} is now: {_NOW[arguments[0]]}", file=sys.stderr)
        return 2
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

    from trinoc.cli.compiler import compile_quickly
    from trinoc.cli.progress import set_up_logging
    from trinoc.io import enable_compile_cache

    compile_quickly()
    set_up_logging(quiet=command.quiet)
    enable_compile_cache()
    try:
        expect_numbers(command)
        expect_places(command)
        outcome = command.run(command_line)
    except TrinocError as error:
        return _failed(command, str(error), status=2 if isinstance(error, UsageError) else 1)
    except BrokenPipeError:
        raise
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _failed(command, f"{place}{error.strerror or error}: check the disk.", status=1)
    except MemoryError:
        return _failed(command, "The memory does not suffice: give smaller or fewer files.", 1)
    except KeyboardInterrupt as stopped:
        said = str(stopped) or "Interrupted: files that were not finished are not there."
        return _failed(command, said, 130)
    record = outcome.record
    if outcome.refusal is not None:
        record = {**record, "error": in_options(outcome.refusal, command)}
        print(f"trinoc: {record['error']}", file=sys.stderr)
    said = json.dumps(record, allow_nan=False) if command.json else outcome.text
    _print(in_options(said, command))
    return 0 if outcome.refusal is None else 1


def _print(text: str) -> None:
    """To stdout, with a question mark for what its encoding lacks."""
    if sys.stdout is None:  # closed
        return
    encoding = sys.stdout.encoding or "utf-8"
    print(text.encode(encoding, errors="replace").decode(encoding))


def _failed(command: Command, sentence: str, status: int) -> int:
    # Names of files and cameras may hold anything; what is said stays one line.
    sentence = " ".join(in_options(sentence, command).splitlines())
    print(f"trinoc: {sentence}", file=sys.stderr)
    if command.json:
        _print(json.dumps({"error": sentence}))
    return status
