"""`trinoc evaluate`: how accurate is the shape that segments give, against a known one?"""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from trinoc.cli.command import Command, FileOrNone, Out, Outcome, UsageError, with_nulls
from trinoc.cli.views import read_rig

if TYPE_CHECKING:
    from trinoc.evaluation.alignment import RigidMotion
    from trinoc.geometry.rig import Rig
    from trinoc.geometry.uncertain_lines import UncertainLines
    from trinoc.match.tracks.matches import Matches


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluateCommand(Command):
    """Compare 3-D segments with a known shape."""

    matches: Path
    """Matches of `trinoc match`."""

    truth: Path
    """The known shape: edges (csv, json), OBJ, polylines (txt), or truth.json of a made scene."""

    rig: FileOrNone = None
    """The cameras; their covariance joins that of the segments."""

    form: Literal["tracks", "joined", "corners", "wireframe"] = "tracks"
    """What is compared: tracks one by one; joined to straight lines; these carried to the corners
    they meet in; or the edges of the wire frame. All but tracks need --rig."""

    stage: Literal["all", "trinocular"] = "all"
    """Which tracks are compared: all, or those that three views show."""

    least_posterior: float = 0.0
    """Compare only tracks of this probability or more."""

    within_mm: tuple[float, ...] = (0.1, 0.25, 0.5, 1.0)
    """Distances at which precision and completeness are given."""

    unit_mm: float = 1.0
    """Length of one unit of the known shape's file."""

    crease_deg: float = 30.0
    """Faces of an OBJ that turn by more than this meet in an edge."""

    grey_step: float = 8.0
    """An edge of a made scene with a smaller step of grey levels counts as not shown."""

    align: bool = False
    """First lay the segments on the shape by a rigid motion; figures are then those after it."""

    out: Out = Path("evaluation.csv")
    """Where the numbers go, as a table of one row."""

    def run(self, command_line: str) -> Outcome:
        """Evaluate the matches, and write the numbers."""
        if not self.within_mm:
            raise UsageError("--within-mm has no distance: give one or more, or leave it out.")
        if self.rig is None and self.form != "tracks":
            raise UsageError("Lines are joined by what the cameras saw of them: add --rig.")

        from trinoc.evaluation.evaluation import EvaluationStatus, evaluate
        from trinoc.io.atomic import expect_place, save_table
        from trinoc.io.known_shape import load_shape
        from trinoc.io.saving import expect_marked, load_matches
        from trinoc.report.evaluations import evaluation_text

        expect_place(self.out)
        # Every table of this command has this column.
        expect_marked(self.out, b"least_posterior", force=self.force)
        shape = load_shape(
            self.truth,
            unit_mm=self.unit_mm,
            crease_deg=self.crease_deg,
            grey_step=self.grey_step,
        )
        matches = load_matches(self.matches)
        rig = None if self.rig is None else read_rig(self.rig).take(matches.views)
        if rig is not None and shape.wants_every_edge:
            shape = shape.visible_to(rig)
        lines = self._lines(matches, rig)
        evaluation = evaluate(lines, shape, tolerances_mm=self.within_mm, aligned=self.align)
        choice = {name: getattr(self, name) for name in ("form", "stage", "least_posterior")}
        row = {**choice, **evaluation.record()}
        save_table([row], self.out)
        text = evaluation_text(evaluation)
        if evaluation.status is not EvaluationStatus.COMPARED:
            text += f"\n\n{evaluation.status.value}"
        record = {
            "wanted": shape.wanted,
            "status": evaluation.status.value,
            **with_nulls(row),
            "motion": _describe_motion(evaluation.motion),
        }
        return Outcome(text, record, written=(self.out,))

    def _lines(self, matches: "Matches", rig: "Rig | None") -> "UncertainLines":
        """The compared lines, with the cameras' errors where the rig states them."""
        import numpy as np

        from trinoc.evaluation.lines_of_rig import independent_lines, lines_of_form
        from trinoc.match.tracks.matches import TRINOCULAR

        kept = matches.posterior >= self.least_posterior
        if self.stage == TRINOCULAR:
            kept &= matches.stage == TRINOCULAR
        tracks = matches.take(np.flatnonzero(kept))
        if rig is None:
            return independent_lines(tracks.lines_mm, tracks.covariance_mm2)
        return lines_of_form(tracks, rig, self.form)


def _describe_motion(motion: "RigidMotion | None") -> dict[str, Any] | None:
    """The motion that laid the segments on the shape."""
    if motion is None:
        return None
    return {
        "rotation": motion.rotation.tolist(),
        "shift_mm": motion.shift_mm.tolist(),
        "turn_deg": motion.turn_deg,
        "rank": motion.rank,
    }
