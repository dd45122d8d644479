"""One run of a command, shared by the tests that read its output and its files."""

import contextlib
import io
import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from trinoc.cli.main import main
from trinoc.io.compile_cache import COMPILE_CACHE_VARIABLE


class Run(NamedTuple):
    """Status of a command and what it wrote to stdout and stderr, and the folder it ran in."""

    status: int
    stdout: str
    stderr: str
    folder: Path

    @property
    def record(self) -> dict[str, Any]:
        """The object that `--json` prints."""
        return json.loads(self.stdout)


def run_command(arguments: Sequence[str], folder: Path) -> Run:
    """Run a command in a folder, without a trace in this process. For fixtures of a module."""
    logger = logging.getLogger("trinoc")
    before = logger.handlers[:], logger.level, logger.propagate
    stdout, stderr = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(COMPILE_CACHE_VARIABLE, "off")
        patch.chdir(folder)
        with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
            status = main(list(arguments))
    logger.handlers[:], logger.level, logger.propagate = before
    return Run(status, stdout.getvalue(), stderr.getvalue(), folder)
