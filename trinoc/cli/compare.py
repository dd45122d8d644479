"""`trinoc compare`: two calibrations of one rig, camera by camera."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated

import tyro

from trinoc.cli.command import Command, Outcome
from trinoc.cli.views import read_rig


@dataclasses.dataclass(frozen=True, kw_only=True)
class CompareCommand(Command):
    """Say what changed between two calibrations of a rig over a sheet that lay still."""

    rig: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RIG.json")]
    """The rig now."""

    earlier: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EARLIER.json")]
    """The rig before."""

    def run(self, command_line: str) -> Outcome:
        """Compare, and say what moved."""
        from trinoc.calib.rig_check.comparison import compare_rigs
        from trinoc.report.text import text_table

        comparison = compare_rigs(read_rig(self.rig), read_rig(self.earlier))
        head = ("camera", "moved (mm)", "turned (deg)", "sigmas", "field (px)", "field (sigmas)")
        rows = [
            (
                name,
                f"{change.moved_mm:.4f}",
                f"{change.turned_deg:.5f}",
                _brief(change.sigmas),
                f"{change.field_px:.4f}",
                _brief(change.field_sigmas),
            )
            for name, change in comparison.cameras.items()
        ]
        record = {
            "moved": [name for name, change in comparison.cameras.items() if change.moved],
            "swapped": [list(pair) for pair in comparison.swapped],
            "cameras": {name: each._asdict() for name, each in comparison.cameras.items()},
        }
        return Outcome("\n".join([*comparison.sentences, text_table(head, rows)]), record)


def _brief(number: float) -> str:
    return f"{number:.1f}" if math.isfinite(number) else "not known"
