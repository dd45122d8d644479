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
    """Print one sentence about an unexpected exception, write its report, return exit status 1.

    The sentence goes to stderr. With `--json` among the arguments, stdout has the object that
    every failed command prints.
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
    """Return the class and the message of an exception as one line, without its final stop."""
    message = " ".join(str(error).split()).removesuffix(".")
    if len(message) > _LONGEST_MESSAGE:
        message = f"{message[:_LONGEST_MESSAGE].rstrip()} ..."
    name = type(error).__name__
    return f"{name}: {message}" if message else name


def _write_report(error: Exception, arguments: Sequence[str]) -> str:
    """Write the report to the current or the temporary folder; return a sentence on where it is."""
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
    """Return the command line, the traceback and the versions as text."""
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
    """Return what is installed; if that raises too, the version of Python and the reason."""
    try:
        from trinoc.cli.installation import describe_installation

        return describe_installation()[0]
    except Exception as error:  # a library that cannot be imported may be the error itself
        return (
            f"python {platform.python_version()} on {platform.platform()}; the other versions are "
            f"not known: {_name_error(error)}"
        )
