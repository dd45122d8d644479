"""The rig that a command is given, and what its calibration said against it."""

import os
from typing import TYPE_CHECKING

from trinoc.cli.progress import LOGGER

if TYPE_CHECKING:
    from trinoc.geometry import Rig
    from trinoc.report import ExtraTable


def read_rig(file: str | os.PathLike[str]) -> "Rig":
    """The rig of a file; a warning on stderr repeats what its calibration doubted."""
    from trinoc.io import load_rig

    rig = load_rig(file)
    doubts = doubts_of(file)
    if doubts:
        said = ", ".join(f"{name} ({doubt.removesuffix('.')})" for name, doubt in doubts.items())
        LOGGER.warning("the calibration in %s is SUSPECT: %s", file, said)
    return rig


def doubts_of(file: str | os.PathLike[str]) -> dict[str, str]:
    """For each camera whose calibration was suspect, why."""
    from trinoc.io import load_rig_status

    return load_rig_status(file).doubts


def doubts_table(file: str | os.PathLike[str]) -> "list[ExtraTable]":
    """The same for a report: a table, or none where nothing was doubted."""
    from trinoc.report import ExtraTable

    caption = "The segments in space inherit these errors, which their sigmas do not hold."
    rows = list(doubts_of(file).items())
    return [ExtraTable("SUSPECT cameras", ("camera", "why"), rows, caption)] if rows else []
