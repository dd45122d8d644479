"""Calibrate fixed cameras from one picture each, and match line segments across them.

The names below are imported when they are first used, so that `import trinoc` is quick. The
rooms behind them tell in their docstrings what is done there: `trinoc.calib`, `trinoc.segments`,
`trinoc.match`, `trinoc.geometry`, `trinoc.evaluation`, `trinoc.io`.
"""

import os

import lazy_loader

from trinoc.numerics.compile_notice import set_compile_notice
from trinoc.numerics.display import set_displays
from trinoc.numerics.forked import note_fork

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def _displays():  # pyright: ignore[reportUnusedFunction]
    from trinoc.report.notebook.displays import NotebookDisplays

    return NotebookDisplays()


# Values show themselves by what the report draws, which they do not know.
set_displays(_displays)
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=note_fork)


def _notice_compiling(is_kept: bool, seconds: float) -> None:
    from trinoc.io.compile_cache import log_compiling

    log_compiling(is_kept, seconds)


# Compiling tells of itself through the log, which stands on a floor above it.
set_compile_notice(_notice_compiling)
