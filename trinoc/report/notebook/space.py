"""A value as the figure in space that the report shows: layers of lines in mm."""

from functools import singledispatch

import numpy as np

from trinoc.calib.bundle.result import RefineResult
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.features import Feature
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import Matches
from trinoc.report.features_part import features_figure
from trinoc.report.space_content import Box, content_box, sheet_outlines, whole_box
from trinoc.report.space_part import (
    LineLayer,
    SpaceFigure,
    SpaceView,
    cameras_in_space,
    space_figure,
)


@singledispatch
def figure_in_space(value: object, *, rig: Rig | None = None) -> SpaceFigure:
    """3-D figure of a value. For features and matches, the cameras of `rig` are drawn, too."""
    raise TypeError(f"{type(value).__name__} has no figure in space: use plot().")


@figure_in_space.register
def _(value: Rig) -> SpaceFigure:
    return space_figure(value, None, None)


@figure_in_space.register
def _(value: Pattern) -> SpaceFigure:
    box = content_box(value, None)
    views = () if box is None else (SpaceView("Sheet", box),)
    return SpaceFigure((LineLayer("sheet", "sheet", sheet_outlines(value)),), (), views)


@figure_in_space.register
def _(value: CalibrationResult) -> SpaceFigure:
    sheet = value.target if isinstance(value.target, Pattern) and not value.views else None
    return space_figure(value.rig, sheet, None)


@figure_in_space.register
def _(value: Matches, *, rig: Rig | None = None) -> SpaceFigure:
    return SpaceFigure.of_tracks(value) if rig is None else space_figure(rig, None, value)


@figure_in_space.register
def _(value: Feature, *, rig: Rig | None = None) -> SpaceFigure:
    return features_figure(value, rig)


@figure_in_space.register
def _(value: RefineResult) -> SpaceFigure:
    lines = list(np.asarray(value.lines.ends_mm))
    content = Box.around(np.concatenate(lines), 0.08) if lines else None
    view = SpaceView("Lines and cameras", whole_box(value.rig, content))
    figure = SpaceFigure((LineLayer("lines", "three", lines),), (), (view,))
    return figure.join(cameras_in_space(value.rig))
