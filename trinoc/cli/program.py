"""The program `trinoc`: what holds from the first moment to the last byte of output.

Imports take a second, in which Ctrl-C is an interruption like any other; whoever reads the output
may stop reading it; a program that is told to end removes its scratch files. Python's own warnings
are not shown, and an unexpected exception becomes one sentence and a file.
"""

import gc
import os
import signal
import sys
import warnings
from types import FrameType

INTERRUPTED, READER_GONE = 130, 141


def run() -> int:
    """Run the command line of this process and return the exit status."""
    _without_closed_streams()
    # Matrices here have some hundred rows: threads of OpenBLAS wait for each other longer than they
    # work, and on busy cores take a hundred times as long.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _hide_warnings()
    # Imports and traces make what stays: looking through it so often takes a tenth of a command.
    gc.set_threshold(500_000, 20, 20)
    try:
        for ending in ("SIGTERM", "SIGHUP"):
            if hasattr(signal, ending):
                signal.signal(getattr(signal, ending), _end)
        from trinoc.cli.main import main

        status = main()
        sys.stdout.flush()
        # Python collects garbage three times while it ends: a tenth of a command.
        gc.freeze()
    except KeyboardInterrupt:
        print("trinoc: Interrupted: unfinished files were not written.", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # Python would complain again at exit, when it flushes what nobody reads.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return READER_GONE
    except Exception as error:
        from trinoc.cli.error_report import report_error

        return report_error(error, sys.argv[1:])
    return status


def _hide_warnings() -> None:
    """Hide the warnings of Python and NumPy, here and in child processes.

    They name lines of code, which do not help a user. `python -W` and PYTHONWARNINGS show them.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"


def _end(number: int, _: FrameType | None) -> None:
    """Signal handler that raises SystemExit, so that temporary files are removed."""
    raise SystemExit(128 + number)


def _without_closed_streams() -> None:
    """Replace standard streams that the shell closed (`>&-`), which are None in Python, by null
    devices.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
