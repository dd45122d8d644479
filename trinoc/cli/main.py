"""The `trinoc` command: reads the command line, runs one command, prints its outcome.

Exit status 0: done. 1: the job failed, and one sentence on stderr says why and what to do
next. 2: wrong usage. 130: interrupted. 141: nobody read the output to its end.
"""

import dataclasses
import errno
import importlib
import inspect
import json
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from typing import Any

import tyro

from trinoc.cli.checks import expect_options
from trinoc.cli.command import LOGGER, Job, Outcome, UsageError, set_up_logging
from trinoc.cli.options import SHARED, list_options
from trinoc.cli.settings import put_files_first, with_file
from trinoc.errors import TrinocError

DESCRIPTION = (
    "Calibrate fixed cameras from one image each of a printed sheet, and match line segments "
    "across their images into 3-D segments with error bars. `trinoc COMMAND --help` explains a "
    "command. `trinoc --version` prints the versions of trinoc and of its packages."
)
# Each command and the file of this package that has its function, which is called like it.
COMMANDS = {
    "demo": "demo",
    "pattern": "pattern",
    "watch": "watch",
    "intrinsics": "intrinsics",
    "calibrate": "calibrate",
    "calibrate-rig": "calibrate_rig",
    "segments": "segments",
    "match": "match",
    "batch": "batch",
    "refine": "refine",
    "check": "refine",
    "compare": "refine",
    "undistort": "undistort",
    "evaluate": "evaluate",
    "export": "export",
}


def find_command(name: str) -> Callable[..., Outcome]:
    """Function of a command. Its parameters are the options, and `--help` shows its docstring."""
    module = importlib.import_module(f"trinoc.cli.{COMMANDS[name]}")
    return getattr(module, name.replace("-", "_"))


def parse_arguments(arguments: Sequence[str]) -> inspect.BoundArguments:
    """Parse the command line and return the command with its arguments.

    Raises SystemExit after help, and after an error that tyro has printed.
    """
    config = (tyro.conf.FlagCreatePairsOff,)
    if arguments and arguments[0] in COMMANDS:
        name, *rest = arguments
        return tyro.cli(_binder(name), prog=f"trinoc {name}", args=rest, config=config)
    return tyro.extras.subcommand_cli_from_dict(
        {name: _binder(name) for name in COMMANDS},
        prog="trinoc",
        description=DESCRIPTION,
        args=arguments,
        config=config,
    )


def _binder(name: str) -> Callable[..., inspect.BoundArguments]:
    """Function that tyro calls in place of a command: same options, but the command is not run.

    It returns the arguments, bound to the command's parameters.
    """
    command = find_command(name)

    def bind(*arguments: Any, **options: Any) -> inspect.BoundArguments:
        job = Job(**{name: options.pop(name) for name in SHARED})
        return inspect.signature(command).bind(*arguments, **options, job=job)

    parameters = [
        inspect.Parameter(
            option.name,
            inspect.Parameter.KEYWORD_ONLY if option.typed else inspect.Parameter.POSITIONAL_ONLY,
            default=option.default,
            annotation=option.annotation(),
        )
        for option in list_options(command)
    ]
    signed: Any = bind  # tyro reads these
    signed.__signature__ = inspect.Signature(parameters)
    signed.__annotations__ = {each.name: each.annotation for each in parameters}
    signed.__doc__ = inspect.getdoc(command).partition("\n\n")[0]  # pyright: ignore
    return signed


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments == ["--version"]:
        return _print_version()
    try:
        if arguments and arguments[0] in COMMANDS:
            in_order = put_files_first(find_command(arguments[0]), arguments[1:])
            arguments = with_file([arguments[0], *in_order])
        call = parse_arguments(arguments)
    except UsageError as error:
        print(f"trinoc: {error}", file=sys.stderr)
        return 2
    except SystemExit as exit_:
        return int(exit_.code or 0)
    command_line = shlex.join(["trinoc", *arguments])
    call.arguments["job"] = dataclasses.replace(call.arguments["job"], command_line=command_line)
    return _run(find_command(arguments[0]), call)


def _print_version() -> int:
    from trinoc.cli.installation import describe_installation

    text, remedies = describe_installation()
    print(text)
    for remedy in remedies:
        print(f"trinoc: {remedy}.", file=sys.stderr)
    return 1 if remedies else 0


def compile_quickly() -> None:
    """Choose XLA's faster code generator, and the CPU, unless environment variables choose
    otherwise.

    On a GPU, the tracks and the time of matching are equal, but compilation takes twice as long,
    and a repeated command takes 13.6 s, on the CPU 5.3 s.
    """
    from trinoc.numerics.compiler_options import quick_compiling

    user_flags = os.environ.get("XLA_FLAGS", "")
    flags = [
        f"--{name}={str(value).lower()}"
        for name, value in quick_compiling().items()
        if name not in user_flags
    ]
    if flags:
        os.environ["XLA_FLAGS"] = " ".join([*flags, user_flags]).rstrip()
    os.environ.setdefault("JAX_PLATFORMS", "cpu")


def _run(command: Callable[..., Outcome], call: inspect.BoundArguments) -> int:
    """Run a command, print its output or its error, and return the exit status."""
    # Small LAPACK calls are many times slower when their threads fight over busy cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from trinoc.io.compile_cache import compile_cache_for

    job: Job = call.arguments["job"]
    set_up_logging(quiet=job.quiet)
    if sys.stderr.isatty():  # a person waits
        LOGGER.info("loading")
    compile_quickly()
    try:
        with compile_cache_for(command.__name__):
            expect_options(call)
            outcome = command(*call.args, **call.kwargs).with_files()
    except TrinocError as error:
        return _report_failure(job, str(error), status=2 if isinstance(error, UsageError) else 1)
    except BrokenPipeError:
        raise
    except OSError as error:
        prefix = f"{error.filename}: " if error.filename else ""
        is_long = error.errno == errno.ENAMETOOLONG
        remedy = "give a shorter name" if is_long else "check the disk"
        return _report_failure(job, f"{prefix}{error.strerror or error}: {remedy}.", status=1)
    except MemoryError:
        return _report_failure(job, "The memory is not sufficient: give smaller or fewer files.", 1)
    except KeyboardInterrupt as stopped:
        sentence = str(stopped) or "Interrupted: unfinished files were not written."
        return _report_failure(job, sentence, 130)
    record = outcome.record
    if outcome.refusal is not None:
        record = {**record, "error": outcome.refusal}
        print(f"trinoc: {outcome.refusal}", file=sys.stderr)
    _print(json.dumps(record, allow_nan=False) if job.json else outcome.text)
    return 0 if outcome.refusal is None else 1


def _print(text: str) -> None:
    """Print to stdout. Characters that the encoding lacks become question marks."""
    if sys.stdout is None:  # closed
        return
    encoding = sys.stdout.encoding or "utf-8"
    print(text.encode(encoding, errors="replace").decode(encoding))


def _report_failure(job: Job, sentence: str, status: int) -> int:
    # Names of files and cameras may hold anything; the sentence stays one line.
    sentence = " ".join(sentence.splitlines())
    print(f"trinoc: {sentence}", file=sys.stderr)
    if job.json:
        _print(json.dumps({"error": sentence}))
    return status
