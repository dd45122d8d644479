"""Evaluations as figures: accuracy, shares and normalised errors over the settings tried.

What is drawn is decided once, as curves of plain numbers; matplotlib then draws it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trinoc.errors import InputError
from trinoc.evaluation.sweep import Row
from trinoc.io.atomic import atomic_write
from trinoc.report.notebook.extras import expect_extra
from trinoc.report.space_content import PALETTE

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
    for curve in panel.curves:
        axes.plot(
            curve.x,
            curve.y,
            color=PALETTE[curve.colour % len(PALETTE)],
            linestyle=("--" if curve.dashed else "-") if curve.joined else "none",
            marker="o",
            markersize=4,
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
