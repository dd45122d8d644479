"""Card of a value in a notebook: a heading, a small picture and the first rows of its table."""

from functools import singledispatch
from html import escape
from typing import Any

import numpy as np

from trinoc.calib.bundle.result import RefineResult
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import list_names
from trinoc.evaluation.evaluation import Evaluation
from trinoc.geometry.features import Feature
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.observations.unusable import sigma_across_px
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tuning.tracks import DecoyTuning
from trinoc.numerics.tables import Table
from trinoc.report.features_part import feature_table
from trinoc.report.matches_part import tracks_table
from trinoc.report.notebook.space import figure_in_space
from trinoc.report.notebook.tables import list_columns
from trinoc.report.numbers import with_decimals, with_sigma
from trinoc.report.parameter_table import lens_table, rig_table
from trinoc.report.report_table import ReportTable, draw_table
from trinoc.report.space_content import BLACK, BLUE, COLOUR_OF_ROLE

ROWS, ROWS_OF_PARAMETERS = 8, 24
SIDE_PX = 220
# A picture of thousands of lines would make the notebook heavy.
MOST_LINES = 400

Strokes = list[tuple[list[np.ndarray], str]]


def make_card(value: object) -> str:
    """Return the HTML of a value for a notebook: heading, notes, table and a small drawing."""
    table = card_table(value)._replace(look="")
    notes = "".join(f"<p>{escape(note)}</p>" for note in getattr(value, "notes", ()))
    return (
        f'<div style="display:flex;gap:1.5em;align-items:flex-start;flex-wrap:wrap">'
        f"{_svg(small_picture(value))}<div><p><b>{escape(type(value).__name__)}</b>: "
        f"{escape(heading(value))}</p>{notes}{draw_table(table)}</div></div>"
    )


@singledispatch
def card_table(value: Any) -> ReportTable:
    """Table of a value for its card: the table of the report if it has one, else of its columns."""
    columns = value.named_columns(brief=True) if isinstance(value, Table) else list_columns(value)
    count = len(next(iter(columns.values()), []))
    row_count = ROWS_OF_PARAMETERS if "parameter" in columns else ROWS
    cells = {
        name: [_cell_text(item) for item in each[:row_count]] for name, each in columns.items()
    }
    if "sigma" in cells:
        del cells["sigma"]
        pairs = zip(columns["value"], columns["sigma"], strict=True)
        cells["value"] = [with_sigma(float(number), float(sigma)) for number, sigma in pairs]
    rows = list(zip(*cells.values()))
    if count == 1:
        return ReportTable((), list(zip(cells, rows[0], strict=True)))
    return _first_rows(ReportTable(tuple(cells), rows), count, row_count)


def _first_rows(table: ReportTable, count: int, shown: int = ROWS) -> ReportTable:
    """First `shown` of the table's rows, with a note on the number of further rows.

    count : number of rows in total.
    """
    note = f"{count - shown} more rows: to_frame()" if count > shown else ""
    return table._replace(rows=table.rows[:shown], row_attributes=(), note=note)


@card_table.register
def _(rig: Rig) -> ReportTable:
    return rig_table(rig)


@card_table.register
def _(result: CalibrationResult) -> ReportTable:
    return lens_table(result) if result.views else rig_table(result.rig)


@card_table.register
def _(matches: Matches) -> ReportTable:
    return _first_rows(tracks_table(matches), len(matches))


@card_table.register
def _(features: Feature) -> ReportTable:
    if features.READ_FIRST:
        return _first_rows(feature_table(features), len(features))
    return card_table.dispatch(object)(features)


def _cell_text(item: Any) -> str:
    return with_decimals(float(item), 3) if isinstance(item, float | np.floating) else str(item)


@singledispatch
def heading(value: object) -> str:
    """Summary of a value in one line."""
    return ""


@heading.register
def _(rig: Rig) -> str:
    covariance = "with a covariance" if len(rig.parameters) else "without a covariance"
    return f"{len(rig)} cameras ({list_names(rig)}), {covariance}"


@heading.register
def _(result: CalibrationResult) -> str:
    cameras = ", ".join(f"{name} {status.name}" for name, status in result.status.items())
    return f"{cameras}; sigmas include {', '.join(('noise', *result.systematics))}"


@heading.register
def _(result: RefineResult) -> str:
    agree = int(np.asarray(result.inlier).sum())
    return f"{result.status.value} {len(result.lines)} lines, {agree} fragments agree"


@heading.register
def _(pattern: Pattern) -> str:
    rings = int((np.asarray(pattern.inner_radius_mm) > 0).sum())
    return f"{pattern.name}, {len(pattern)} circles, {rings} of them rings"


@heading.register
def _(segments: Segments) -> str:
    if not len(segments):
        return "none"
    ends, covariance = (np.asarray(e) for e in (segments.endpoints_px, segments.covariance_px2))
    length = float(np.median(np.asarray(segments.length_px)))
    across = float(np.median(sigma_across_px(ends, covariance)))
    return (
        f"{len(segments)} segments, in the median {length:.1f} px long, +- {across:.2g} px across"
    )


@heading.register
def _(matches: Matches) -> str:
    stage = np.asarray(matches.stage)
    three, two = int((stage == TRINOCULAR).sum()), int((stage == BINOCULAR).sum())
    sure = int((np.asarray(matches.posterior) > DecoyTuning.sure_posterior).sum())
    return (
        f"{matches.status.value} {three} tracks in three views or more, {two} in two "
        f"({list_names(matches.views)}); {sure} of probability over {DecoyTuning.sure_posterior}"
    )


@heading.register
def _(features: Feature) -> str:
    return features.summary()


@heading.register
def _(evaluation: Evaluation) -> str:
    return f"{evaluation.status.value} Wanted: {evaluation.wanted}."


def small_picture(value: object) -> Strokes:
    """Lines of a small drawing of a value, with y downward, as (lines, colour) for each layer.

    For values in space, the drawing is a view from above.
    """
    if isinstance(value, Segments):
        return [(list(np.asarray(value.endpoints_px)), BLUE)]
    if isinstance(value, Evaluation):
        return []
    return [
        ([part[:, :2] * [1, -1] for part in layer.parts], COLOUR_OF_ROLE.get(layer.role, BLACK))
        for layer in figure_in_space(value).layers
        if layer.shown and layer.role != "axes"
    ]


def _svg(strokes: Strokes) -> str:
    """SVG of the lines, scaled to a square; "" without lines."""
    points = [part for parts, _ in strokes for part in parts[:MOST_LINES]]
    if not points:
        return ""
    points_px = np.concatenate(points)
    points_px = points_px[np.isfinite(points_px).all(axis=1)]
    if not len(points_px):
        return ""
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    margin = 0.05 * max(float(np.max(high - low)), 1e-9)
    left, top = (low - margin).tolist()
    width, height = (high - low + 2 * margin).tolist()
    step = max(width, height) / 2000
    paths = "".join(
        f'<path fill="none" vector-effect="non-scaling-stroke" stroke-width="1.3" '
        f'stroke="{colour}" d="{"".join(_path(part, step) for part in parts[:MOST_LINES])}"/>'
        for parts, colour in strokes
    )
    return (
        f'<svg width="{SIDE_PX}" height="{SIDE_PX}" role="img" aria-label="small picture" '
        f'viewBox="{left:.3g} {top:.3g} {width:.4g} {height:.4g}">{paths}</svg>'
    )


def _path(part: np.ndarray, step: float) -> str:
    """Data of an SVG path for one line, rounded to a fraction of `step`."""
    if not np.isfinite(part).all():
        return ""
    decimals = max(0, round(-np.log10(step)))
    return "M" + "L".join(f"{x:.{decimals}f} {y:.{decimals}f}" for x, y in part.tolist())
