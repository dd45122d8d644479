"""Progress and logs, which go to stderr so that stdout holds results only."""

import logging
import sys
from collections.abc import Collection, Iterator
from typing import TypeVar

LOGGER = logging.getLogger("trinoc")

_Item = TypeVar("_Item")


def set_up_logging(*, quiet: bool) -> None:
    """Send the package's log to stderr: steps as well as warnings, or only warnings."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("trinoc: %(message)s"))
    LOGGER.handlers[:] = [handler]
    LOGGER.setLevel(logging.WARNING if quiet else logging.INFO)
    LOGGER.propagate = False


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
