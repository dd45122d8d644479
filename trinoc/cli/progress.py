"""Progress and logs, which go to stderr so that stdout holds results only."""

import hashlib
import logging
import os
import sys
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import trinoc

LOGGER = logging.getLogger("trinoc")

_Item = TypeVar("_Item")


def set_up_logging(*, quiet: bool) -> None:
    """Send the package's log to stderr: steps as well as warnings, or only warnings."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("trinoc: %(message)s"))
    LOGGER.handlers[:] = [handler]
    LOGGER.setLevel(logging.WARNING if quiet else logging.INFO)
    LOGGER.propagate = False


class Bar:
    """A progress bar on stderr for work that says how far it is."""

    def __init__(self, doing: str, *, quiet: bool) -> None:
        self._doing, self._quiet, self._bar = doing, quiet, None

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def show(self, done: int, total: int) -> None:
        """Show that so many of so many are done."""
        from tqdm import tqdm

        if self._bar is None:
            self._bar = tqdm(
                total=total,
                desc=f"trinoc: {self._doing}",
                leave=False,
                file=sys.stderr,
                disable=self._quiet or not sys.stderr.isatty(),
            )
        self._bar.update(done - self._bar.n)


def each(items: Collection[_Item], doing: str, *, quiet: bool) -> Iterator[_Item]:
    """The items, with a progress bar on stderr that leaves no trace."""
    from tqdm import tqdm

    yield from tqdm(
        items,
        desc=f"trinoc: {doing}",
        leave=False,
        file=sys.stderr,
        disable=quiet or not sys.stderr.isatty(),
    )


def provenance(command_line: str, inputs: Mapping[str, str | os.PathLike[str]]) -> dict[str, Any]:
    """The "provenance" object of a file; equal inputs give equal objects, so it has no date."""
    return {
        "command": command_line,
        "version": trinoc.__version__,
        "inputs": {
            name: {
                "file": Path(path).name,
                "sha256": hashlib.sha256(Path(path).read_bytes()).hexdigest(),
            }
            for name, path in inputs.items()
        },
    }


def for_people(origin: Mapping[str, Any]) -> dict[str, str]:
    """The same as lines of text, for the foot of a report."""
    files = {
        name: f"{entry['file']} (sha256 {entry['sha256'][:12]})"
        for name, entry in origin["inputs"].items()
    }
    return {"command": origin["command"], "version": origin["version"], **files}
