"""`trinoc check`: has a camera been knocked since the calibration? Asked of matched scenes."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from trinoc.cli.command import Command, FileOrNone, Outcome
from trinoc.cli.progress import LOGGER
from trinoc.cli.views import read_rig


@dataclasses.dataclass(frozen=True, kw_only=True)
class CheckCommand(Command):
    """Say by how many sigma each camera has moved since its calibration, from a scene alone."""

    images: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="NAME=FILE", help_behavior_hint="(or --matches)"),
    ] = ()
    """For each camera its picture of a scene as it sees it now, or segments found before (npz,
    npy, csv, txt): these are matched here, again and again, so that a large knock is found too."""

    rig: Path
    """The cameras, as `trinoc calibrate` writes them."""

    matches: FileOrNone = None
    """Matches of such a scene, as `trinoc match` writes them: enough for a small knock."""

    out: Annotated[
        Path | None,
        tyro.conf.arg(aliases=("-o",), metavar="FILE", help_behavior_hint="(default: none)"),
    ] = None
    """Where the corrected rig goes, if one camera has moved and the scene tells where it is now."""

    def run(self, command_line: str) -> Outcome:
        """Check, and write the corrected rig where there is one and it is wanted."""
        from trinoc.calib.rig_check.knocked import check_rig
        from trinoc.cli.progress import provenance
        from trinoc.cli.views import read_scene
        from trinoc.geometry.rig import Rig
        from trinoc.io.atomic import expect_place
        from trinoc.io.saving import expect_ending, save

        expect_place(self.out)
        expect_ending(self.out, Rig)
        rig = read_rig(self.rig)
        scene = read_scene(self.images, self.matches, rig, self.rig, quiet=self.quiet)
        LOGGER.info("checking %d cameras with %d lines", len(rig), len(scene.matches))
        again = [match for match in (scene.tolerant, scene.strict) if match is not None]
        check = check_rig(rig, scene.matches, match_again=again or None)
        refined = check.refined
        written = None if refined is None else self.out
        if refined is not None and written is not None:
            inputs = {"rig": self.rig, **scene.files}
            save(refined.rig, written, provenance=provenance(command_line, inputs))
        record = {
            "conclusive": check.conclusive,
            "moved": list(check.moved),
            "corrected": refined is not None,
            "sigmas": {motion.name: motion.sigmas for motion in check.motions},
        }
        return Outcome(check.summary(), record, written=(written,))
