"""Readers of other libraries in a child process, which a damaged file may crash, stall or fill.

A crash of compiled code ends the process that runs it. Such a reader therefore runs in a process of
its own with limits of time and memory, and its answer comes back as JSON, which holds no code.
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
    """A reader in a child refuses the content, for the reason that it names."""


def read_in_child(
    reader: str, content: bytes, path: str | os.PathLike[str], seconds: float = MOST_SECONDS
) -> Any:
    """Return the JSON value that a reader makes of a file's content, in a child process.

    Parameters
    ----------
    reader : "module:function" of a function that takes the content. Its module is imported in the
        child and should import little.
    content : of the file, which the caller has read.
    path : of the file, for messages.
    seconds : after which the child is ended.

    Raises
    ------
    InputError : where the reader raises an exception, crashes, or exceeds time or memory.
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
    """In the child: print the value that `reader` makes of stdin, or the problem, as JSON."""
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
