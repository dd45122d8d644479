"""`trinoc evaluate`: the accuracy of matched segments against a known shape."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import trinoc
from trinoc.cli.command import Job, Outcome, UsageError, as_json, pick
from trinoc.cli.views import read_rig

if TYPE_CHECKING:
    from trinoc.geometry.uncertain_lines import UncertainLines


def evaluate(
    *,
    matches: Path,
    truth: Path,
    rig: Path | None = None,
    form: Literal["tracks", "joined", "corners", "wireframe"] = "tracks",
    stage: Literal["all", "trinocular"] = "all",
    least_posterior: float = 0.0,
    within_mm: tuple[float, ...] = (0.1, 0.25, 0.5, 1.0),
    unit_mm: float = 1.0,
    crease_deg: float = 30.0,
    grey_step: float = 8.0,
    align: bool = False,
    out: Path = Path("evaluation.csv"),
    job: Job,
) -> Outcome:
    """Compare 3-D segments with a known shape.

    Parameters
    ----------
    matches
        Matches, as `trinoc match` writes them.
    truth
        The known shape: edges (csv, json), OBJ, polylines (txt), or truth.json of a rendered scene.
    rig
        The calibrated cameras. Their covariance is added to that of the segments.
    form
        What is compared: single tracks; straight lines joined from tracks; these lines extended to
        their corners; or the edges of the wire frame. All but tracks need --rig.
    stage
        Compare all tracks, or only those of three views.
    least_posterior
        Compare only tracks with at least this posterior probability.
    within_mm
        Distances at which precision and completeness are computed.
    unit_mm
        Length in mm of one unit in the file of the known shape.
    crease_deg
        Smallest angle between two faces of an OBJ whose common side is an edge.
    grey_step
        Smallest step in grey levels of an edge of a rendered scene; fainter edges are ignored.
    align
        Align the segments with the shape by a rigid motion before the comparison.
    out
        Table with one row of results.
    """
    if not within_mm:
        raise UsageError("--within-mm has no distance: give at least one, or omit --within-mm.")
    if rig is None and form != "tracks":
        raise UsageError("Joining collinear lines needs the rig: add --rig.")

    from trinoc.evaluation.evaluation import EvaluationStatus
    from trinoc.io.atomic import expect_place
    from trinoc.io.saving import expect_marked
    from trinoc.report.evaluations import evaluation_text

    expect_place(out)
    # Every table of this command has this column.
    expect_marked(out, b"least_posterior", force=job.force)
    shape = trinoc.io.load_shape(truth, unit_mm=unit_mm, crease_deg=crease_deg, grey_step=grey_step)
    tracks = trinoc.load_matches(matches)
    cameras = None if rig is None else read_rig(rig).take(tracks.views)
    if cameras is not None and shape.wants_every_edge:
        shape = shape.visible_to(cameras)
    lines = _lines(tracks, cameras, form, stage, least_posterior)
    result = trinoc.evaluate(lines, shape, tolerances_mm=within_mm, aligned=align)
    choice = {"form": form, "stage": stage, "least_posterior": least_posterior}
    row = {**choice, **result.record()}
    trinoc.io.save_table([row], out)
    text = evaluation_text(result)
    if result.status is not EvaluationStatus.COMPARED:
        text += f"\n\n{result.status.value}"
    motion = result.motion
    record = {
        "wanted": shape.wanted,
        "status": result.status.value,
        **as_json(row),
        "motion": motion and pick(motion, "rotation", "shift_mm", "turn_deg", "rank"),
    }
    return Outcome(text, record, written=(out,))


def _lines(
    matches: "trinoc.Matches",
    rig: "trinoc.Rig | None",
    form: str,
    stage: str,
    least_posterior: float,
) -> "UncertainLines":
    """Lines to compare, with the covariance of the cameras if the rig has one.

    form, stage, least_posterior : options of the command.
    """
    import numpy as np

    from trinoc.evaluation.lines_of_rig import independent_lines, lines_of_form
    from trinoc.match.tracks.matches import TRINOCULAR

    is_used = matches.posterior >= least_posterior
    if stage == TRINOCULAR:
        is_used &= matches.stage == TRINOCULAR
    tracks = matches.take(np.flatnonzero(is_used))
    if rig is None:
        return independent_lines(tracks.lines_mm, tracks.covariance_mm2)
    return lines_of_form(tracks, rig, form)
