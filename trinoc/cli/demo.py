"""`trinoc demo`: the whole job on bundled pictures, ending in a report."""

import contextlib
import shlex
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import trinoc
from trinoc.cli.calibrate import calibration_record
from trinoc.cli.command import LOGGER, Job, Outcome, as_json
from trinoc.cli.match import match_record, refusal_of
from trinoc.cli.views import make_folder

if TYPE_CHECKING:
    import numpy as np

    from trinoc.evaluation.scoring import LengthScore

TOLERANCE_MM = 1.0
# Edges across which the grey levels of a picture differ by less do not count as shown in it.
GREY_STEP = 8.0
REFERENCE_NAME = "Table 1"
TITLE = "trinoc demo: three cameras and a scene of blocks"


def demo(
    *,
    out: Path = Path("trinoc-demo"),
    keep_inputs: bool = False,
    job: Job,
) -> Outcome:
    """Calibrate with three bundled images, match a scene of blocks, and write a report.

    Parameters
    ----------
    out : DIR
        Folder for report.html, rig.json and matches.npz. It is created if it does not exist.
    keep_inputs
        Also write the images and the sheet to the folder, and print the command for each result.
    """
    from trinoc.match.tracks.reliability import assess_matches
    from trinoc.report.parameter_table import parameter_errors
    from trinoc.report.text import counts_text, errors_text, reasons_text

    seconds: dict[str, float] = {}
    make_folder(out)
    work = _work(seconds)
    score, assessment = _score(work.matches), assess_matches(work.matches)
    with _step("writing the report", seconds):
        written = _write(out, work, score, job)
    errors = parameter_errors(work.result.rig, work.known)
    matching = match_record(work.segments, work.matches, assessment)
    tracks = matching["tracks"]
    report, rig, matches = written
    text = [
        errors_text(errors, REFERENCE_NAME),
        counts_text(work.matches),
        reasons_text(work.matches),
        f"{tracks['trinocular']} tracks seen in three views, {tracks['binocular']} in two.\n"
        f"{_sentence(score)}",
        assessment.sentence,
        f"written: {rig}, {matches}\nreport, for a browser: {report}",
    ]
    inputs, lines = [], []
    if keep_inputs:
        inputs, lines = _keep_inputs(out), _commands()
        text.append(
            "\n".join(["Commands for the same result:", f"cd {shlex.quote(str(out))}", *lines])
            + "\ntrinoc.toml there says the same, so that `trinoc calibrate` and `trinoc match` do."
        )
    LOGGER.info("done in %.1f s", sum(seconds.values()))
    record = {
        **calibration_record(work.result),
        "table_1": {
            f"{error.camera}.{error.parameter}": {
                "known": error.known,
                "error": error.error,
                "error_over_sigma": as_json(error.over_sigma),
            }
            for error in errors
        },
        **matching,
        "score": {
            "tolerance_mm": TOLERANCE_MM,
            "grey_step": GREY_STEP,
            "length_precision": score.edges.precision,
            "length_recall": score.edges.recall,
            "length_recall_with_rims": score.with_rims.recall,
        },
        "seconds": seconds,
        "written": [str(path) for path in (*written, *inputs)],
        "commands": lines,
    }
    return Outcome("\n\n".join(text), record, refusal_of(assessment))


class DemoWork(NamedTuple):
    """Inputs and results of the demo.

    Attributes
    ----------
    sheets, scenes : dict
        Pictures of the sheet and of the scene, by view.
    known : Rig
        True cameras.
    result : CalibrationResult
        Calibration.
    segments : dict of Segments
        Segments of the scene, by view.
    matches : Matches
        Matches of the segments.
    """

    sheets: "dict[str, np.ndarray]"
    scenes: "dict[str, np.ndarray]"
    known: "trinoc.Rig"
    result: "trinoc.calib.CalibrationResult"
    segments: "dict[str, trinoc.Segments]"
    matches: "trinoc.Matches"


def _work(seconds: dict[str, float]) -> DemoWork:
    """Calibrate the demo's cameras and match its scene. seconds : receives the duration of each
    step.
    """
    from trinoc.io.demo import demo_images, demo_pattern
    from trinoc.synth.rigs import table1_lens, table1_rig

    sheets, scenes = demo_images("sheet"), demo_images("scene")
    with _step("calibrating from the pictures of the sheet", seconds):
        # The pictures are made: their lens is exact, and so is the size of their sheet.
        priors = trinoc.Systematics.typical({})._replace(
            print_size_sigma=0.0, print_scale_sigma=(0.0, 0.0)
        )
        result = trinoc.calibrate(sheets, demo_pattern(), table1_lens(), systematics=priors)
    with _step("finding segments in the pictures of the blocks", seconds):
        segments = {view: trinoc.find_segments(picture) for view, picture in scenes.items()}
    with _step("matching them", seconds):
        matches = trinoc.match_segments(segments, result.rig)
    return DemoWork(sheets, scenes, table1_rig(), result, segments, matches)


class Score(NamedTuple):
    """Scores of the demo's lines against the true edges: without and with the cylinder's rims."""

    edges: "LengthScore"
    with_rims: "LengthScore"


def _score(matches: "trinoc.Matches") -> Score:
    from trinoc.evaluation.scoring import score_lengths
    from trinoc.io.demo import demo_truth

    edges, with_rims = (
        score_lengths(
            matches.lines_mm,
            demo_truth(),
            tolerance_mm=TOLERANCE_MM,
            grey_step=GREY_STEP,
            kinds=kinds,
        )
        for kinds in (("edge",), None)
    )
    return Score(edges, with_rims)


def _write(folder: Path, work: DemoWork, score: Score, job: Job) -> tuple[Path, Path, Path]:
    from trinoc.cli.command import for_people
    from trinoc.io.demo import demo_paths
    from trinoc.report.html import ExtraTable, write_report

    inputs = {
        f"{kind} {view}": path
        for kind in ("sheet", "scene")
        for view, path in demo_paths(kind).items()
    }
    report, rig, matches = (folder / name for name in ("report.html", "rig.json", "matches.npz"))
    trinoc.save(work.result, rig, provenance=job.provenance(demo_paths("sheet")), overwrite=True)
    trinoc.save(work.matches, matches, overwrite=True)
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
        provenance=for_people(job.provenance(inputs)),
    )
    return report, rig, matches


def _sentence(score: Score) -> str:
    return (
        f"Of the length put out, {score.edges.precision:.1%} lies within {TOLERANCE_MM:g} mm of an "
        "edge of the scene. Of the straight edges that two pictures or more show (grey levels "
        f"differing by {GREY_STEP:g} or more across them), {score.edges.recall:.1%} of the length "
        "was found."
    )


@contextlib.contextmanager
def _step(doing: str, seconds: dict[str, float]) -> Iterator[None]:
    """Context manager that logs a step of the demo, and stores its duration in `seconds`."""
    LOGGER.info(doing)
    start = time.perf_counter()
    yield
    seconds[doing] = round(time.perf_counter() - start, 3)


def _keep_inputs(folder: Path) -> list[Path]:
    """Write the pictures, the layout of the sheet and trinoc.toml; return the files."""
    from trinoc.io.atomic import write_text
    from trinoc.io.demo import demo_paths, demo_pattern

    inputs = folder / "inputs"
    inputs.mkdir(exist_ok=True)
    written = []
    for kind in ("sheet", "scene"):
        for view, copy in _pictures(kind).items():
            shutil.copyfile(demo_paths(kind)[view], folder / copy)
            written.append(folder / copy)
    trinoc.save(demo_pattern(), inputs / "sheet.json", overwrite=True)
    write_text(folder / "trinoc.toml", _toml())
    return [*written, inputs / "sheet.json", folder / "trinoc.toml"]


def _pictures(kind: str) -> dict[str, str]:
    from trinoc.io.demo import demo_paths

    paths = demo_paths(kind)
    return {view: f"inputs/{kind}_{view}{Path(path).suffix}" for view, path in paths.items()}


def _commands() -> list[str]:
    """Command lines that produce the demo's rig and matches in its folder."""
    sheets, scenes = (
        [f"{view}={file}" for view, file in _pictures(kind).items()] for kind in ("sheet", "scene")
    )
    # The demo's pictures are made: lens and print are exactly what is said of them.
    exact = ["--lens-mm", "16", "0.0162", "0.0134", "--sigma", "lens=0", "print_scale=0"]
    lines = [
        ["trinoc", "calibrate", *sheets, "--board", "inputs/sheet.json", *exact,
         "-o", "my-rig.json", "--report", "my-calibration.html"],
        ["trinoc", "match", *scenes, "--rig", "my-rig.json", "-o", "my-matches.npz",
         "--report", "my-matches.html"],
        ["trinoc", "export", "my-matches.npz", "--to", "ply", "-o", "my-segments.ply"],
    ]  # fmt: skip
    return [shlex.join(line) for line in lines]


def _toml() -> str:
    """Text of trinoc.toml, with which `trinoc calibrate` and `trinoc match` need no arguments."""
    sheets, scenes = (
        ", ".join(f'{view} = "{file}"' for view, file in _pictures(kind).items())
        for kind in ("sheet", "scene")
    )
    return f"""\
[calibrate]
images = {{{sheets}}}
board = "inputs/sheet.json"
lens_mm = [16, 0.0162, 0.0134]
sigma = {{lens = 0, print_scale = 0}}
out = "my-rig.json"

[match]
images = {{{scenes}}}
rig = "my-rig.json"
out = "my-matches.npz"
"""
