"""The last handler of the command line: one sentence, and a file to attach to a report."""

import datetime
import json
import os
import platform
import shlex
import sys
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path

# numerical: characters of the exception's message that the sentence repeats.
_LONGEST_MESSAGE = 200
_REMEDY = "Attach it to a report of this error."


def report_error(error: Exception, arguments: Sequence[str]) -> int:
    """Print one sentence about an unexpected exception, write an error report, and return exit
    status 1.

    The sentence goes to stderr. If `--json` is among the arguments, a JSON object goes to stdout.
    """
    sentence = (
        f"trinoc stopped at an internal error: {_name_error(error)}. "
        f"{_write_report(error, arguments)}"
    )
    print(f"trinoc: {sentence}", file=sys.stderr)
    if "--json" in arguments:
        print(json.dumps({"error": sentence}))
    return 1


def _name_error(error: Exception) -> str:
    """Class and message of an exception as one line without a final full stop."""
    message = " ".join(str(error).split()).removesuffix(".")
    if len(message) > _LONGEST_MESSAGE:
        message = f"{message[:_LONGEST_MESSAGE].rstrip()} ..."
    name = type(error).__name__
    return f"{name}: {message}" if message else name


def _write_report(error: Exception, arguments: Sequence[str]) -> str:
    """Write the error report to the current or the temporary folder. Return a sentence with its
    path.
    """
    text = _report_text(error, arguments)
    moment = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    name = f"trinoc-error-{moment}-{os.getpid()}.txt"
    for folder in (Path(), Path(tempfile.gettempdir())):
        try:
            with (folder / name).open("x", encoding="utf-8") as file:
                file.write(text)
        except OSError:
            continue
        return f"The details are in {folder / name}. {_REMEDY}"
    return (
        "No folder could be written to: run the command again in a folder that you can write to, "
        "and attach the file that it leaves there to a report of this error."
    )


def _report_text(error: Exception, arguments: Sequence[str]) -> str:
    """Text of the error report: command line, traceback and versions."""
    return "\n".join(
        (
            f"command: {shlex.join(['trinoc', *arguments])}",
            "",
            "".join(traceback.format_exception(error)),
            _list_versions(),
            "",
        )
    )


def _list_versions() -> str:
    """Versions of the installed packages as text; the version of Python if they cannot be
    determined.
    """
    try:
        from trinoc.cli.installation import describe_installation

        return describe_installation()[0]
    except Exception as error:  # a library that cannot be imported may be the error itself
        return (
            f"python {platform.python_version()} on {platform.platform()}; the other versions are "
            f"not known: {_name_error(error)}"
        )
