"""Options of the commands that show a page, and how they say where it is."""

import sys
from typing import Annotated

import tyro

from trinoc.cli.command import UsageError

Port = Annotated[int, tyro.conf.arg(help_behavior_hint="(default: a free one)")]


def expect_port(port: int) -> None:
    """Raises UsageError: a server's thread would fail by itself, and the command wait on."""
    if not 0 <= port <= 65535:
        raise UsageError(f"--port is {port}: give one up to 65535, or none for a free one.")


def show(url: str, browser: bool) -> None:
    """Say where to look, also to whom is `--quiet`: nothing else can be done without it."""
    print(f"trinoc: open {url} in a browser; Ctrl-C ends it", file=sys.stderr, flush=True)
    if browser:
        import webbrowser

        webbrowser.open(url)
