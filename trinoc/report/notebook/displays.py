"""The ways in which a value shows itself, each by its kind; figures of plotly."""

from functools import singledispatch
from typing import Any

import numpy as np

from trinoc.calib.bundle.result import RefineResult
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import expect_extra
from trinoc.evaluation.evaluation import Evaluation
from trinoc.geometry.features import Feature
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.precision import is_traced
from trinoc.report.features_part import features_figure
from trinoc.report.notebook.axes import plot_value
from trinoc.report.notebook.cards import heading, make_card
from trinoc.report.notebook.tables import list_columns
from trinoc.report.space_content import BLACK, COLOUR_OF_ROLE, frusta, polyline, sheet_outlines
from trinoc.report.space_part import LineLayer, SpaceFigure, space_figure


class NotebookDisplays:
    """What `trinoc.numerics.Displayable` asks for."""

    def heading(self, value: Any) -> str:
        """A line of text; within `jit`, `grad` or `vmap` there are no numbers to tell."""
        return "traced" if is_traced(value) else heading(value)

    def html(self, value: Any) -> str:
        """A table and a small picture, as HTML."""
        return make_card(value)

    def plot(self, value: Any, axes: Any, **options: Any) -> Any:
        """On axes of matplotlib, which are returned."""
        return plot_value(value, axes, **options)

    def show(self, value: Any, **options: Any) -> Any:
        """A figure of plotly."""
        return make_figure(value, **options)

    def to_frame(self, value: Any) -> Any:
        """A table of pandas."""
        return make_frame(value)


def make_frame(value: object) -> Any:
    """A DataFrame, a row for each item. Raises InputError where pandas is missing."""
    expect_extra("pandas", "notebook")
    import pandas

    return pandas.DataFrame(list_columns(value))


def make_figure(value: object, **options: Any) -> Any:
    """A Figure of plotly. Raises InputError where plotly is missing."""
    expect_extra("plotly", "notebook")
    return _figure(value, **options)


@singledispatch
def _figure(value: object) -> Any:
    raise TypeError(f"{type(value).__name__} has no figure.")


@_figure.register
def _(rig: Rig) -> Any:
    return _in_space(space_figure(rig, None, None).layers)


@_figure.register
def _(result: CalibrationResult) -> Any:
    return _in_space(space_figure(result.rig, result.pattern, None).layers)


@_figure.register
def _(matches: Matches, *, rig: Rig | None = None) -> Any:
    """The segments with their ends and sigmas under the pointer, and the cameras of `rig`."""
    if rig is not None:
        return _in_space(space_figure(rig, None, matches).layers)
    return _in_space(SpaceFigure.of_tracks(matches).layers)


@_figure.register
def _(features: Feature, *, rig: Rig | None = None) -> Any:
    """The lines with what is known of each under the pointer, and the cameras of `rig`."""
    return _in_space(features_figure(features, rig).layers)


@_figure.register
def _(result: RefineResult) -> Any:
    lines = LineLayer("lines", "three", list(np.asarray(result.lines.ends_mm)))
    return _in_space((lines, LineLayer("cameras", "cameras", frusta(result.rig))))


@_figure.register
def _(pattern: Pattern) -> Any:
    return _flat([outline[:, :2] for outline in sheet_outlines(pattern)], "X (mm)", "Y (mm)")


@_figure.register
def _(segments: Segments) -> Any:
    figure = _flat(list(np.asarray(segments.endpoints_px)), "u (px)", "v (px)")
    figure.update_yaxes(autorange="reversed")
    return figure


@_figure.register
def _(evaluation: Evaluation) -> Any:
    import plotly.graph_objects as go

    shares = {"precision": evaluation.precision, "completeness": evaluation.completeness}
    traces = [
        go.Scatter(x=list(evaluation.tolerances_mm), y=list(share), name=name)
        for name, share in shares.items()
    ]
    labels = {"xaxis_title": "within (mm)", "yaxis_title": "share of length"}
    return go.Figure(traces, labels)


def _in_space(layers: tuple[LineLayer, ...]) -> Any:
    import plotly.graph_objects as go

    traces = []
    for layer in layers:
        x, y, z = polyline(layer.parts or [np.full((1, 3), np.nan)]).T
        words = [
            text
            for part, said in zip(layer.parts, layer.words or ("",) * len(layer.parts), strict=True)
            for text in (*[said.replace(". ", ".<br>").replace("; ", "<br>")] * len(part), "")
        ]
        traces.append(
            go.Scatter3d(
                x=x,
                y=y,
                z=z,
                name=layer.name,
                text=words,
                hoverinfo="text" if layer.words else "skip",
                mode="lines" if all(len(part) > 1 for part in layer.parts) else "markers",
                visible=True if layer.shown else "legendonly",
                line={"color": COLOUR_OF_ROLE.get(layer.role, BLACK), "width": 4},
                marker={"color": COLOUR_OF_ROLE.get(layer.role, BLACK), "size": 3},
            )
        )
    scene = {f"{axis}axis_title": f"{axis.upper()} (mm)" for axis in "xyz"}
    figure = go.Figure(traces)
    figure.update_layout(scene={**scene, "aspectmode": "data"}, margin=dict.fromkeys("lrtb", 0))
    return figure


def _flat(lines: list[np.ndarray], x_label: str, y_label: str) -> Any:
    import plotly.graph_objects as go

    gap = np.full((1, 2), np.nan)
    points = np.concatenate([row for line in lines for row in (line, gap)] or [gap])
    figure = go.Figure(go.Scatter(x=points[:, 0], y=points[:, 1], mode="lines"))
    figure.update_layout(xaxis_title=x_label, yaxis_title=y_label)
    figure.update_yaxes(scaleanchor="x")
    return figure
