"""`trinoc demo`: the whole job on bundled pictures, ending in a report."""

import contextlib
import dataclasses
import math
import shlex
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import tyro

from trinoc.cli.calibrate import calibration_record
from trinoc.cli.command import LOGGER, Command, Outcome
from trinoc.cli.match import match_record, refusal_of
from trinoc.cli.views import make_folder

if TYPE_CHECKING:
    import numpy as np

    from trinoc.calib.result.calibration import CalibrationResult
    from trinoc.evaluation.scoring import LengthScore
    from trinoc.geometry.rig import Rig
    from trinoc.geometry.segments import Segments
    from trinoc.match.tracks.matches import Matches
    from trinoc.match.tracks.reliability import MatchAssessment
import shutil

TOLERANCE_MM = 1.0
# Edges across which the grey levels of a picture differ by less do not count as shown in it.
GREY_STEP = 8.0
REFERENCE_NAME = "Table 1"
TITLE = "trinoc demo: three cameras and a scene of blocks"


@dataclasses.dataclass(frozen=True, kw_only=True)
class DemoCommand(Command):
    """Calibrate three bundled pictures, match a scene of blocks, and write a report."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",), metavar="DIR")] = Path("trinoc-demo")
    """The folder for report.html, rig.json and matches.npz; made where it is not there."""

    keep_inputs: bool = False
    """Also leave the pictures and the sheet there, and print the commands that make each result."""

    def run(self, command_line: str) -> Outcome:
        """Do the whole job, the same functions as the other commands in the same order."""
        from trinoc.match.tracks.reliability import assess_matches

        seconds: dict[str, float] = {}
        make_folder(self.out)
        work = _work(seconds)
        score, assessment = _score(work.matches), assess_matches(work.matches)
        with _step("writing the report", seconds):
            written = _write(self.out, work, score, command_line)
        kept, by_hand = [], ""
        if self.keep_inputs:
            kept = keep_inputs(self.out)
            by_hand = _by_hand(self.out)
        LOGGER.info("done in %.1f s", sum(seconds.values()))
        return Outcome(
            _text(work, assessment, score, written) + by_hand,
            {
                **_record(work, assessment, score),
                "seconds": seconds,
                "written": [str(path) for path in (*written, *kept)],
                "commands": commands() if self.keep_inputs else [],
            },
            refusal_of(assessment),
        )


def _by_hand(folder: Path) -> str:
    """The same, a command at a time."""
    lines = "\n".join(commands())
    return (
        f"\n\nThe same by hand:\ncd {shlex.quote(str(folder))}\n{lines}\n"
        "trinoc.toml there says the same, so that `trinoc calibrate` and `trinoc match` do."
    )


class DemoWork(NamedTuple):
    """What went in and what came out, by view."""

    sheets: "dict[str, np.ndarray]"
    scenes: "dict[str, np.ndarray]"
    known: "Rig"
    result: "CalibrationResult"
    segments: "dict[str, Segments]"
    matches: "Matches"


def _work(seconds: dict[str, float]) -> DemoWork:
    from trinoc.calib.sheet_calibration import calibrate
    from trinoc.calib.uncertainty.systematics import Systematics
    from trinoc.io.demo import demo_images, demo_pattern
    from trinoc.match.matcher import match_segments
    from trinoc.segments.find import find_segments
    from trinoc.synth.rigs import table1_lens, table1_rig

    sheets, scenes = demo_images("sheet"), demo_images("scene")
    with _step("calibrating from the pictures of the sheet", seconds):
        # The pictures are made: their lens is exact, and so is the size of their sheet.
        known = Systematics.typical({})._replace(print_size_sigma=0.0, print_scale_sigma=(0.0, 0.0))
        result = calibrate(sheets, demo_pattern(), table1_lens(), systematics=known)
    with _step("finding segments in the pictures of the blocks", seconds):
        segments = {view: find_segments(picture) for view, picture in scenes.items()}
    with _step("matching them", seconds):
        matches = match_segments(segments, result.rig)
    return DemoWork(sheets, scenes, table1_rig(), result, segments, matches)


class Score(NamedTuple):
    """Against the truth: straight edges alone, and the chords of the cylinder's rims as well."""

    edges: "LengthScore"
    with_rims: "LengthScore"


def _score(matches: "Matches") -> Score:
    from trinoc.evaluation.scoring import score_lengths
    from trinoc.io.demo import demo_truth

    def score(kinds: tuple[str, ...] | None) -> "LengthScore":
        return score_lengths(
            matches.lines_mm,
            demo_truth(),
            tolerance_mm=TOLERANCE_MM,
            grey_step=GREY_STEP,
            kinds=kinds,
        )

    return Score(score(("edge",)), score(None))


def _write(
    folder: Path, work: DemoWork, score: Score, command_line: str
) -> tuple[Path, Path, Path]:
    from trinoc.cli.command import for_people, provenance
    from trinoc.io.demo import demo_paths
    from trinoc.io.saving import save
    from trinoc.report.html import ExtraTable, write_report

    sheet_files, scene_files = demo_paths("sheet"), demo_paths("scene")
    origin = provenance(command_line, sheet_files)
    both = {
        f"{kind} {view}": path
        for kind, files in (("sheet", sheet_files), ("scene", scene_files))
        for view, path in files.items()
    }
    report, rig, matches = (folder / name for name in ("report.html", "rig.json", "matches.npz"))
    save(work.result, rig, provenance=origin, overwrite=True)
    save(work.matches, matches, overwrite=True)
    rows = [
        ("length put out (mm)", f"{score.edges.length_put_out_mm:.0f}"),
        ("precision of it", f"{score.edges.precision:.1%}"),
        ("length of the straight edges shown (mm)", f"{score.edges.length_true_mm:.0f}"),
        ("recall of them", f"{score.edges.recall:.1%}"),
        ("the same with the rims of the cylinder (mm)", f"{score.with_rims.length_true_mm:.0f}"),
        ("recall with the rims", f"{score.with_rims.recall:.1%}"),
    ]
    write_report(
        report,
        result=work.result,
        sheet_pictures=work.sheets,
        segments=work.segments,
        matches=work.matches,
        scene_pictures=work.scenes,
        reference=work.known,
        reference_name=REFERENCE_NAME,
        title=TITLE,
        tables=[ExtraTable("Against the truth", ("measure", "value"), rows, _sentence(score))],
        provenance=for_people(provenance(command_line, both)),
    )
    return report, rig, matches


def _sentence(score: Score) -> str:
    return (
        f"Of the length put out, {score.edges.precision:.1%} lies within {TOLERANCE_MM:g} mm of an "
        "edge of the scene. Of the straight edges that two pictures or more show (grey levels "
        f"differing by {GREY_STEP:g} or more across them), {score.edges.recall:.1%} of the length "
        "was found."
    )


def _text(
    work: DemoWork, assessment: "MatchAssessment", score: Score, written: tuple[Path, Path, Path]
) -> str:
    from trinoc.report.parameter_table import parameter_errors
    from trinoc.report.text import counts_text, errors_text, reasons_text

    report, rig, matches = written
    tracks = match_record(work.segments, work.matches, assessment)["tracks"]
    return "\n\n".join(
        (
            errors_text(parameter_errors(work.result.rig, work.known), REFERENCE_NAME),
            counts_text(work.matches),
            reasons_text(work.matches),
            f"{tracks['trinocular']} tracks seen in three views, {tracks['binocular']} in two.\n"
            f"{_sentence(score)}",
            assessment.sentence,
            f"written: {rig}, {matches}\nreport, for a browser: {report}",
        )
    )


def _record(work: DemoWork, assessment: "MatchAssessment", score: Score) -> dict[str, Any]:
    from trinoc.report.parameter_table import parameter_errors

    return {
        **calibration_record(work.result),
        "table_1": {
            f"{found.camera}.{found.parameter}": {
                "known": found.known,
                "error": found.error,
                "error_over_sigma": found.over_sigma if math.isfinite(found.over_sigma) else None,
            }
            for found in parameter_errors(work.result.rig, work.known)
        },
        **match_record(work.segments, work.matches, assessment),
        "score": {
            "tolerance_mm": TOLERANCE_MM,
            "grey_step": GREY_STEP,
            "length_precision": score.edges.precision,
            "length_recall": score.edges.recall,
            "length_recall_with_rims": score.with_rims.recall,
        },
    }


@contextlib.contextmanager
def _step(doing: str, seconds: dict[str, float]) -> Iterator[None]:
    """Say on stderr what is being done, and note how long it took."""
    LOGGER.info(doing)
    start = time.perf_counter()
    yield
    seconds[doing] = round(time.perf_counter() - start, 3)


# The demo's pictures are made: lens and print are exactly what is said of them.
LENS = ("--lens-mm", "16", "0.0162", "0.0134", "--sigma", "lens=0", "print_scale=0")


def keep_inputs(folder: Path) -> list[Path]:
    """Write pictures, layout of the sheet and trinoc.toml beside the results."""
    from trinoc.io.atomic import write_text
    from trinoc.io.demo import demo_paths, demo_pattern
    from trinoc.io.saving import save

    inputs = folder / "inputs"
    inputs.mkdir(exist_ok=True)
    written = []
    for kind in ("sheet", "scene"):
        for view, path in demo_paths(kind).items():
            copy = inputs / f"{kind}_{view}{Path(path).suffix}"
            shutil.copyfile(path, copy)
            written.append(copy)
    save(demo_pattern(), inputs / "sheet.json", overwrite=True)
    write_text(folder / "trinoc.toml", _toml())
    return [*written, inputs / "sheet.json", folder / "trinoc.toml"]


def commands() -> list[str]:
    """The command lines, to be run in the demo's folder, that make its rig and its matches."""
    sheets, scenes = (_pictures(kind) for kind in ("sheet", "scene"))
    named = [[f"{view}={file}" for view, file in files.items()] for files in (sheets, scenes)]
    lines = [
        ["trinoc", "calibrate", *named[0], "--board", "inputs/sheet.json", *LENS,
         "-o", "my-rig.json", "--report", "my-calibration.html"],
        ["trinoc", "match", *named[1], "--rig", "my-rig.json", "-o", "my-matches.npz",
         "--report", "my-matches.html"],
        ["trinoc", "export", "my-matches.npz", "--to", "ply", "-o", "my-segments.ply"],
    ]  # fmt: skip
    return [shlex.join(line) for line in lines]


def _pictures(kind: str) -> dict[str, str]:
    from trinoc.io.demo import demo_paths

    return {
        view: f"inputs/{kind}_{view}{Path(path).suffix}" for view, path in demo_paths(kind).items()
    }


def _toml() -> str:
    """So that `trinoc calibrate` and `trinoc match` need no arguments there."""

    def table(files: dict[str, str]) -> str:
        return "{" + ", ".join(f'{view} = "{file}"' for view, file in files.items()) + "}"

    return f"""\
[calibrate]
images = {table(_pictures("sheet"))}
board = "inputs/sheet.json"
lens_mm = [16, 0.0162, 0.0134]
sigma = {{lens = 0, print_scale = 0}}
out = "my-rig.json"

[match]
images = {table(_pictures("scene"))}
rig = "my-rig.json"
out = "my-matches.npz"
"""
