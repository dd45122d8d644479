"""Readers of other libraries, run in a child process with limits of time and memory.

A damaged file may crash compiled code, and a crash ends the process. The result comes back as JSON,
which contains no code.
"""

import contextlib
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from trinoc.errors import InputError

MOST_SECONDS = 30.0
MOST_MEMORY_BYTES = 4 << 30
_PROGRAM = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from trinoc.io.child_process import answer; answer(sys.argv[2])"
)


class DamagedError(Exception):
    """A reader in a child process rejects the content of a file; the message is the reason."""


def read_in_child(
    reader: str, content: bytes, path: str | os.PathLike[str], seconds: float = MOST_SECONDS
) -> Any:
    """Run a reader of file content in a child process and return its result.

    A crash of the reader then ends only the child process.

    Parameters
    ----------
    reader : str
        Name "module:function". The function takes the content and returns a JSON value. The child
        imports the module, which should therefore import little.
    content : bytes
        Content of the file.
    path : path
        Path of the file, for messages.
    seconds : float
        Time limit.

    Returns
    -------
    JSON value
        Result of the reader.

    Raises
    ------
    InputError
        If the reader raises an exception, crashes, or exceeds the limits of time or memory.
    """
    command = [sys.executable, "-c", _PROGRAM, json.dumps(sys.path), reader]
    # Each thread of OpenBLAS reserves memory.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        child = subprocess.run(
            command,
            input=content,
            capture_output=True,
            timeout=seconds,
            env=environment,
            check=False,
        )
        result = json.loads(child.stdout)
        problem = result.get("problem")
    except subprocess.TimeoutExpired:
        problem = f"reading takes more than {seconds:g} s"
    except json.JSONDecodeError:
        problem = "its reader crashes"
    if problem is not None:
        raise InputError(f"{Path(path)} is damaged ({problem}): write it again.")
    return result["value"]


def answer(reader: str) -> None:
    """Run `reader` on the content of stdin and print its result as JSON: {"value": ...}.

    If the reader fails, print {"problem": reason}. Runs in the child process.
    """
    _limit_memory()
    module, _, function = reader.partition(":")
    try:
        read = getattr(importlib.import_module(module), function)
        result = {"value": read(sys.stdin.buffer.read())}
    except DamagedError as error:
        result = {"problem": str(error)}
    except MemoryError:
        result = {"problem": "the file needs more memory than any valid file"}
    except Exception as error:
        result = {"problem": " ".join(f"{type(error).__name__}: {error}".split())[:200]}
    print(json.dumps(result))


def _limit_memory() -> None:
    with contextlib.suppress(ImportError, ValueError, OSError):  # Windows has no such limit
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))
