"""`trinoc refine`, `check`, `compare`: a rig beside matches made with it, or an earlier rig."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import LOGGER, Command, FileOrNone, Out, Outcome, with_nulls
from trinoc.cli.views import read_rig
from trinoc.errors import CalibrationError

if TYPE_CHECKING:
    from trinoc.calib.bundle.result import RefineResult


@dataclasses.dataclass(frozen=True, kw_only=True)
class RefineCommand(Command):
    """Refine a rig jointly against its calibration and matched segments."""

    images: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="NAME=FILE", help_behavior_hint="(or --matches)"),
    ] = ()
    """For each camera its picture of a scene, or segments found before (npz, npy, csv, txt):
    these are matched here, and again with the refined rig until the matches stop changing."""

    rig: Path
    """The cameras, as `trinoc calibrate` writes them."""

    matches: FileOrNone = None
    """The matches, as `trinoc match` writes them, which are taken as they are."""

    pose_model: Annotated[
        Literal["aimed", "aim-free", "rigid"] | None,
        tyro.conf.arg(
            metavar="aimed|aim-free|rigid",
            help_behavior_hint="(default: those the calibration knows)",
        ),
    ] = None
    """What may change in each camera: aimed: pan, tilt, swing and distance; aim-free: where the
    optical axis meets the sheet, too; rigid: any motion."""

    free_lens: bool = False
    """Refine focal lengths and principal points too, also those that the calibration does not call
    uncertain."""

    moved: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: none)")
    ] = ()
    """Cameras that were knocked since the calibration, whose old place no longer counts."""

    out: Out = Path("refined.json")
    """Where the refined rig goes: the cameras that the matches are of."""

    def run(self, command_line: str) -> Outcome:
        """Refine and write the rig; nothing is written where the refinement fails."""
        from trinoc.calib.bundle.refinement import refine
        from trinoc.calib.bundle.result import RefineStatus
        from trinoc.cli.command import provenance
        from trinoc.cli.views import read_scene
        from trinoc.geometry.rig import Rig
        from trinoc.io.atomic import expect_place
        from trinoc.io.saving import expect_replaceable, save
        from trinoc.recording.camera_aliases import camera_aliases

        expect_place(self.out)
        expect_replaceable(self.out, Rig, force=self.force)
        rig = read_rig(self.rig)
        words = camera_aliases(rig.names)
        scene = read_scene(self.images, self.matches, rig, self.rig, quiet=self.quiet)
        LOGGER.info("refining the cameras of %d lines", len(scene.matches))
        again = [scene.tolerant, scene.strict] if self.moved else [scene.strict]
        result = refine(
            rig,
            scene.matches,
            pose_model=self.pose_model,
            free_lens=self.free_lens or None,
            moved=[words.get(name, name) for name in self.moved],
            match_again=[match for match in again if match is not None] or None,
        )
        if result.status is RefineStatus.AMBIGUOUS:
            raise CalibrationError(
                f"Other rigs than the refined {self.rig} explain the segments about as well, so "
                "nothing was written: calibrate again with the sheet, or take a scene with more "
                "edges."
            )
        if result.status is RefineStatus.NOT_CONVERGED:
            raise CalibrationError(
                f"The refinement of {self.rig} did not converge, so nothing was written: check "
                "that the matches were made with this rig, and match again."
            )
        inputs = {"rig": self.rig, **scene.files}
        save(result.rig, self.out, provenance=provenance(command_line, inputs), overwrite=True)
        return Outcome(result.summary(), refine_record(result), written=(self.out,))


def refine_record(result: "RefineResult") -> dict[str, Any]:
    """What programs want to know of a refinement, as JSON can hold it."""
    variances = result.covariance.diagonal()
    return {
        "status": result.status.name.lower(),
        "gauge": result.gauge,
        "parameters": {
            name: {"value": float(value), "sigma": float(max(variance, 0.0)) ** 0.5}
            for name, value, variance in zip(
                result.parameters, result.values, variances, strict=True
            )
        },
        "lines": len(result.lines),
        "log_posterior": list(result.history),
        "fragments_that_agree": int(result.inlier.sum()),
        "segment_sigma_factor": result.segment_sigma_factor,
        "sheet_sigma_factor": result.sheet_sigma_factor,
        "chi_square": {"after": result.chi_square[0], "before": result.chi_square[1]},
    }


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
        from trinoc.cli.command import provenance
        from trinoc.cli.views import read_scene
        from trinoc.geometry.rig import Rig
        from trinoc.io.atomic import expect_place
        from trinoc.io.saving import expect_replaceable, save

        expect_place(self.out)
        expect_replaceable(self.out, Rig, force=self.force)
        rig = read_rig(self.rig)
        scene = read_scene(self.images, self.matches, rig, self.rig, quiet=self.quiet)
        LOGGER.info("checking the cameras of %d lines", len(scene.matches))
        again = [match for match in (scene.tolerant, scene.strict) if match is not None]
        check = check_rig(rig, scene.matches, match_again=again or None)
        refined = check.refined
        written = None if refined is None else self.out
        if refined is not None and written is not None:
            inputs = {"rig": self.rig, **scene.files}
            save(refined.rig, written, provenance=provenance(command_line, inputs), overwrite=True)
        record = {
            "conclusive": check.conclusive,
            "moved": list(check.moved),
            "corrected": refined is not None,
            "sigmas": {motion.name: motion.sigmas for motion in check.motions},
        }
        return Outcome(check.summary(), record, written=(written,))


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
        from trinoc.report.report_table import text_table

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
            "cameras": {
                name: with_nulls(each._asdict()) for name, each in comparison.cameras.items()
            },
        }
        return Outcome("\n".join([*comparison.sentences, text_table(head, rows)]), record)


def _brief(number: float) -> str:
    return f"{number:.1f}" if math.isfinite(number) else "not known"
