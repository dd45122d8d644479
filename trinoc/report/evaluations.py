"""Evaluations as tables for a terminal, and as figures: accuracy, shares and normalised errors over
the settings tried.

What is drawn is decided once, as curves of plain numbers; matplotlib then draws it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trinoc.errors import InputError, expect_extra
from trinoc.evaluation.sweep import Row
from trinoc.io.atomic import atomic_write
from trinoc.report.numbers import with_decimals
from trinoc.report.space_content import PALETTE
from trinoc.report.text import text_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STATIC_SUFFIXES = (".png", ".svg", ".pdf")
# Knobs that a figure can have along its foot, and what is written there.
KNOBS = {
    "tolerance_px": "tolerance (px)",
    "least_contrast": "least contrast (grey levels)",
    "false_alarms": "false alarms",
    "least_posterior": "least posterior",
}
SHARE_WITHIN = 0.95
COLUMNS = 2


class PlotCurve(NamedTuple):
    """Points of one quantity: what it is, its colour's number, dashed or not, joined or not."""

    name: str
    x: list[float]
    y: list[float]
    colour: int
    dashed: bool = False
    joined: bool = True


class Panel(NamedTuple):
    """One pair of axes; `level` is a line across where the truth would be."""

    title: str
    x_label: str
    y_label: str
    curves: list[PlotCurve]
    log_x: bool = False
    log_y: bool = False
    level: float | None = None


def evaluation_panels(rows: Sequence[Row]) -> list[Panel]:
    """Over the knob that takes several values; where none does, over the distance allowed."""
    done = [row for row in rows if row.evaluation is not None]
    records = [row.record() for row in done]
    swept = [name for name in KNOBS if len({record.get(name) for record in records}) > 1]
    return _over_knob(records, swept[0], _tolerances(done)) if swept else _over_distance(done)


def _tolerances(done: list[Row]) -> tuple[float, ...]:
    found = done[0].evaluation
    return () if found is None else found.tolerances_mm


def draw_panel(axes: "Axes", panel: Panel) -> None:
    """One panel on matplotlib axes."""
    for after, curve in zip(reversed(range(len(panel.curves))), panel.curves, strict=True):
        # Points of several curves at one place are rings about each other.
        rings = 0 if curve.joined else after
        axes.plot(
            curve.x,
            curve.y,
            color=PALETTE[curve.colour % len(PALETTE)],
            linestyle=("--" if curve.dashed else "-") if curve.joined else "none",
            marker="o",
            markersize=4 + 3 * rings,
            fillstyle="none" if rings else "full",
            label=curve.name,
        )
    if panel.level is not None:
        axes.axhline(panel.level, color="#777777", linewidth=1)
    if panel.log_x:
        axes.set_xscale("log")
        ticks = sorted({x for curve in panel.curves for x in curve.x})
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    if panel.log_y:
        axes.set_yscale("log")
        axes.set_yticks(_round_ticks(panel.curves), minor=False)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
    axes.set_title(panel.title)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, framealpha=0.6)


def _round_ticks(curves: list[PlotCurve]) -> list[float]:
    """One, two and five times the powers of ten from below the least value to above the largest."""
    values = [y for curve in curves for y in curve.y if np.isfinite(y) and y > 0] or [1.0]
    low, high = np.floor(np.log10(min(values))), np.ceil(np.log10(max(values)))
    powers = 10.0 ** np.arange(low, high + 1)
    ticks = [step * power for power in powers.tolist() for step in (1, 2, 5)]
    return [tick for tick in ticks if min(values) / 2.5 <= tick <= 2.5 * max(values)]


def expect_plotter(path: Path) -> None:
    """Before a long job: raise InputError where `path` is no figure that can be written."""
    if path.suffix.lower() not in STATIC_SUFFIXES:
        raise InputError(
            f"{path}: a figure is written as {', '.join(STATIC_SUFFIXES)}: choose such a name."
        )
    expect_extra("matplotlib", "plot")


def write_plot(rows: Sequence[Row], path: Path) -> None:
    """All panels side by side, to a file whose ending says how. Raises InputError."""
    expect_plotter(path)
    panels = evaluation_panels(rows)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    lines = -(-len(panels) // COLUMNS)
    figure = Figure(figsize=(5.5 * COLUMNS, 4.2 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    for number, panel in enumerate(panels, start=1):
        draw_panel(figure.add_subplot(lines, COLUMNS, number), panel)
    with atomic_write(path) as file:
        figure.savefig(file, format=path.suffix.lower().removeprefix("."), dpi=150)


def _over_knob(
    records: list[dict[str, Any]], knob: str, tolerances_mm: tuple[float, ...]
) -> list[Panel]:
    others = [name for name in (*KNOBS, "stage", "form") if name != knob and name in records[0]]
    others = [name for name in others if len({str(record[name]) for record in records}) > 1]
    groups: dict[str, list[dict[str, Any]]] = {}
    for record in records:
        name = ", ".join(_in_words(other, record[other]) for other in others)
        groups.setdefault(name, []).append(record)
    for group in groups.values():
        group.sort(key=lambda record: record[knob])
    low, high = min(tolerances_mm), max(tolerances_mm)

    def curves(*columns: tuple[str, str]) -> list[PlotCurve]:
        return [
            PlotCurve(
                f"{label}{', ' if name else ''}{name}",
                [record[knob] for record in group],
                [record[column] for record in group],
                number,
                dashed=place > 0,
            )
            for number, (name, group) in enumerate(groups.items())
            for place, (column, label) in enumerate(columns)
        ]

    positive = all(record[knob] > 0 for record in records)
    common: dict[str, Any] = {"x_label": KNOBS[knob], "log_x": positive}
    shares = (f"precision_{high:g}mm", "precision"), (f"completeness_{high:g}mm", "completeness")
    fine = (f"precision_{low:g}mm", "precision"), (f"completeness_{low:g}mm", "completeness")
    distances = ("distance_median_mm", "median"), ("distance_90_mm", "90 %")
    return [
        Panel(
            title="how far off the lines are",
            y_label="distance from the nearest edge (mm)",
            curves=curves(*distances),
            log_y=True,
            **common,
        ),
        Panel(
            title=f"within {high:g} mm", y_label="share of length", curves=curves(*shares), **common
        ),
        Panel(
            title=f"within {low:g} mm", y_label="share of length", curves=curves(*fine), **common
        ),
        Panel(
            title="do the sigmas say so?",
            y_label="share of errors within 1.96 sigma",
            curves=curves(("share_within_1.96_sigma", "share")),
            level=SHARE_WITHIN,
            **common,
        ),
    ]


def _over_distance(done: list[Row]) -> list[Panel]:
    shares, lengths = [], []
    differ = [
        name for name in ("stage", "form") if len({getattr(r.choice, name) for r in done}) > 1
    ]
    for number, row in enumerate(done):
        found = row.evaluation
        if found is None:
            continue
        name = "".join(f", {_in_words(each, getattr(row.choice, each))}" for each in differ)
        within = list(found.tolerances_mm)
        shares.append(PlotCurve(f"precision{name}", within, list(found.precision), number))
        shares.append(
            PlotCurve(f"completeness{name}", within, list(found.completeness), number, dashed=True)
        )
        measured = np.isfinite(found.lengths.measured_mm)
        true, error = found.lengths.true_mm[measured], found.lengths.error_mm[measured]
        lengths.append(
            PlotCurve(f"edges{name}", true.tolist(), error.tolist(), number, joined=False)
        )
    return [
        Panel("what is right, and what was found", "within (mm)", "share of length", shares, True),
        Panel(
            "lengths of edges", "true length (mm)", "measured less true (mm)", lengths, level=0.0
        ),
    ]


def _in_words(knob: str, value: float | str) -> str:
    if isinstance(value, str):
        return "all tracks" if value == "all" else value
    return f"{KNOBS[knob].partition(' (')[0]} {value:g}"


_KNOBS = {
    "tolerance_px": "tolerance",
    "false_alarms": "alarms",
    "least_contrast": "contrast",
    "least_posterior": "posterior",
    "stage": "stage",
    "form": "form",
}


def evaluation_text(rows: Sequence[Row]) -> str:
    """A line for each setting: the knobs that differ, then what came of it."""
    head, table = evaluation_table(rows)
    done = [row.evaluation for row in rows if row.evaluation is not None]
    parts = [text_table(head, table, left=0)]
    if done:
        low, high = done[0].tolerances_mm[0], done[0].tolerances_mm[-1]
        parts.append(
            "distance: of the length put out from the nearest edge, mm, half and 95 % of it\n"
            f"precision, completeness: shares of length within {low:g} and {high:g} mm\n"
            f"wanted: {done[0].wanted}, {done[0].length_wanted_mm:.0f} mm\n"
            "angle (deg) and length (mm): median error of lines on edges, of edges found\n"
            "sigmas: share of the errors across within 1.96 sigma (true: 95 %), and by how much\n"
            "the sigma of the median line is too small (true: 1)"
        )
    for row in rows:
        if row.evaluation is not None and row.evaluation.wireframe is not None:
            parts.append(_wireframe_text(row.evaluation.wireframe.record()))
    motions = [found.motion for found in done if found.motion is not None]
    if motions:
        parts.append(
            "after laying the segments on the shape: turned by "
            + ", ".join(f"{motion.turn_deg:.4f}" for motion in motions)
            + " deg, shifted by "
            + ", ".join("(" + " ".join(f"{x:.3f}" for x in m.shift_mm) + ")" for m in motions)
            + " mm"
        )
        if any(motion.rank < 6 for motion in motions):
            parts.append("the edges leave a part of this motion free, which was not moved")
    parts.extend(dict.fromkeys(row.problem for row in rows if row.problem))
    return "\n\n".join(parts)


def _wireframe_text(found: dict[str, Any]) -> str:
    return (
        f"wire frame: {found['edges_found']} of {found['edges_wanted']} edges found, "
        f"{found['edges_extra']} extra; {found['corners_found']} of {found['corners_wanted']} "
        f"corners found, {found['corners_extra']} extra, median error "
        f"{_number(found['corner_error_median_mm'], 3)} mm, "
        f"{_number(found['share_of_corners_within_95'], 3)} in their 95 % ellipsoids; "
        f"{found['faces']} faces"
    )


def evaluation_table(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """(names of the columns, cells): knobs with several values first."""
    records = [row.record() for row in rows]
    swept = [name for name in _KNOBS if len({str(r.get(name)) for r in records}) > 1]
    done = [row.evaluation for row in rows if row.evaluation is not None]
    low, high = (done[0].tolerances_mm[0], done[0].tolerances_mm[-1]) if done else (0.0, 0.0)
    head = [_KNOBS[name] for name in swept]
    head += ["segments", "lines", "distance", "95 %"]
    head += [f"{name} {at:g}" for name in ("prec.", "compl.") for at in (low, high)]
    head += ["angle", "length", "in 1.96", "sigmas"]
    table = []
    for row, record in zip(rows, records, strict=True):
        cells = [_knob(record[name]) for name in swept] + [str(row.segments)]
        found = row.evaluation
        if found is None:
            table.append(cells + ["-"] * (len(head) - len(cells)))
            continue
        cells += [
            str(len(found.lines)),
            _number(found.distance_mm.median, 3),
            _number(found.distance_mm.at_95, 3),
            *(_number(share, 3) for share in (found.precision[0], found.precision[-1])),
            *(_number(share, 3) for share in (found.completeness[0], found.completeness[-1])),
            _number(found.angle_deg.median, 3),
            _number(found.length_error_mm.median, 3),
            _number(found.normalised.share_within, 3),
            _number(found.normalised.spread, 2),
        ]
        table.append(cells)
    return head, table


def _knob(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _number(value: float, decimals: int) -> str:
    text = with_decimals(value, decimals)
    return "-" if text == "not known" else text
