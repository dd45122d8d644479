"""`trinoc check`: has a camera been knocked since the calibration? Asked of matched scenes."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from trinoc.cli.command import Command, Outcome
from trinoc.cli.progress import LOGGER


@dataclasses.dataclass(frozen=True, kw_only=True)
class Check(Command):
    """Say by how many sigma each camera has moved since its calibration, from a scene alone."""

    rig: Path
    """The cameras, as `trinoc calibrate` writes them."""

    matches: Path
    """Matches of a scene that the rig sees now, as `trinoc match` writes them."""

    out: Annotated[
        Path | None,
        tyro.conf.arg(aliases=("-o",), metavar="FILE", help_behavior_hint="(default: none)"),
    ] = None
    """Where the mended rig goes, if one camera has moved and the scene tells where it is now."""

    def run(self, command_line: str) -> Outcome:
        """Check, and write the mended rig where there is one and it is wanted."""
        from trinoc.calib.joint.moved import check_rig
        from trinoc.cli.provenance import provenance
        from trinoc.io.matches_npz import load_matches
        from trinoc.io.rig_json import load_rig
        from trinoc.io.save import save

        rig, matches = load_rig(self.rig), load_matches(self.matches)
        LOGGER.info("checking %d cameras with %d lines", len(rig), len(matches))
        check = check_rig(rig, matches)
        written = []
        if self.out is not None and check.refined is not None:
            inputs = {"rig": self.rig, "matches": self.matches}
            save(check.refined.rig, self.out, provenance=provenance(command_line, inputs))
            written = [str(self.out)]
        text = "\n".join([check.summary(), *(f"written: {path}" for path in written)])
        record = {
            "moved": list(check.moved),
            "mended": check.refined is not None,
            "sigmas": {motion.name: motion.sigmas for motion in check.motions},
            "written": written,
        }
        return Outcome(text, record)
