"""Options of the commands that show a page, and how they say where it is."""

import sys
from typing import Annotated

import tyro

Port = Annotated[int, tyro.conf.arg(help_behavior_hint="(default: a free one)")]


def show(url: str, browser: bool) -> None:
    """Say where to look, also to whom is `--quiet`: nothing else can be done without it."""
    print(f"trinoc: open {url} in a browser; Ctrl-C ends it", file=sys.stderr, flush=True)
    if browser:
        import webbrowser

        webbrowser.open(url)
