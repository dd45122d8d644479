"""`trinoc demo`: the whole job on bundled pictures, ending in a report."""

import contextlib
import dataclasses
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from trinoc.cli.calibrate import calibration_record
from trinoc.cli.command import Command, Outcome
from trinoc.cli.match import match_record
from trinoc.cli.progress import LOGGER
from trinoc.errors import InputError

if TYPE_CHECKING:
    from trinoc.report.against_reference import ParameterError

TOLERANCE_MM = 1.0
# Edges across which the grey levels of a picture differ by less are not counted as shown.
GREY_STEP = 8.0
REFERENCE_NAME = "Table 1"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """Calibrate three bundled pictures, match a scene of blocks, and write a report."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",), metavar="DIR")] = Path("trinoc-demo")
    """The folder for report.html, rig.json and matches.npz; made where it is not there."""

    def run(self, command_line: str) -> Outcome:
        """Do the whole job."""
        seconds: dict[str, float] = {}
        with _step("loading", seconds):
            from trinoc.calib.calibrate import calibrate
            from trinoc.cli.provenance import provenance
            from trinoc.io.demo import demo_paths, demo_pattern, demo_pictures, demo_truth
            from trinoc.io.save import save
            from trinoc.match.find_segments import find_segments
            from trinoc.match.match_segments import match_segments
            from trinoc.report.against_reference import parameter_errors
            from trinoc.report.html import ExtraTable, write_report
            from trinoc.report.text import counts_text, errors_text, reasons_text
            from trinoc.synth.rigs import table1_lens, table1_rig
            from trinoc.synth.scoring import length_score

            _make_folder(self.out)
            sheets, scenes, truth = demo_pictures("sheet"), demo_pictures("scene"), demo_truth()
            known = table1_rig()
        with _step("calibrating three pictures of the sheet", seconds):
            result = calibrate(sheets, demo_pattern(), table1_lens())
        with _step("finding segments in three pictures of the blocks", seconds):
            segments = {name: find_segments(picture) for name, picture in scenes.items()}
        with _step("matching them", seconds):
            matches = match_segments(segments, result.rig)
        errors = parameter_errors(result.rig, known)
        score = length_score(
            matches.lines_mm, truth, tolerance_mm=TOLERANCE_MM, grey_step=GREY_STEP
        )
        sentence = (
            f"Of the length put out, {score.precision:.1%} lies within {TOLERANCE_MM:g} mm of an "
            f"edge of the scene; of the edges that two pictures or more show (grey levels differing "
            f"by {GREY_STEP:g} or more), {score.recall:.1%} of the length was found."
        )
        report, rig, found = (self.out / n for n in ("report.html", "rig.json", "matches.npz"))
        files = {
            f"{kind} {view}": path
            for kind in ("sheet", "scene")
            for view, path in demo_paths(kind).items()
        }
        origin = provenance(command_line, files)
        with _step(f"writing {report}", seconds):
            save(result, rig, provenance=origin)
            save(matches, found)
            write_report(
                report,
                result=result,
                sheet_pictures=sheets,
                segments=segments,
                matches=matches,
                scene_pictures=scenes,
                reference=known,
                reference_name=REFERENCE_NAME,
                title="trinoc demo: three cameras and a scene of blocks",
                tables=[
                    ExtraTable(
                        "Against the truth",
                        ("measure", "value"),
                        [
                            ("length precision", f"{score.precision:.1%}"),
                            ("length recall", f"{score.recall:.1%}"),
                        ],
                        sentence,
                    )
                ],
                provenance={"command": origin["command"], "version": origin["version"]},
            )
        written = [str(path) for path in (report, rig, found)]
        tracks = match_record(segments, matches)["tracks"]
        text = "\n\n".join(
            (
                errors_text(errors, REFERENCE_NAME),
                counts_text(matches),
                reasons_text(matches),
                f"{tracks['trinocular']} tracks seen in three views, {tracks['binocular']} in two. "
                + sentence,
                f"report: {report}\nalso written: {rig}, {found}",
            )
        )
        record = {
            **calibration_record(result),
            REFERENCE_NAME.lower().replace(" ", "_"): [_error_record(error) for error in errors],
            **match_record(segments, matches),
            "score": {
                "tolerance_mm": TOLERANCE_MM,
                "grey_step": GREY_STEP,
                "length_precision": score.precision,
                "length_recall": score.recall,
            },
            "seconds": seconds,
            "written": written,
        }
        return Outcome(text, record)
