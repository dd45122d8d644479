"""Values on axes of matplotlib, to build on."""

from collections.abc import Mapping
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
from trinoc.match.tracks.matches import TRINOCULAR, Matches
from trinoc.match.wire_frame.frame import Wireframe
from trinoc.report import plot
from trinoc.report.notebook.space import figure_in_space
from trinoc.report.numbers import plain, round_scale
from trinoc.report.space_content import (
    BLACK,
    BLUE,
    COLOUR_OF_ROLE,
    GREEN,
    VERMILION,
    frusta,
    sheet_outlines,
)

# The longest residual arrow, as a share of the picture's width.
ARROW_SHARE = 0.09


def plot_value(value: object, axes: Any, **options: Any) -> Any:
    """Draw a value with matplotlib, and return the axes.

    axes : axes to draw on; None for new axes. options : as the value's `plot` takes them.

    Raises InputError if matplotlib is not installed.
    """
    expect_extra("matplotlib", "plot")
    return _plot(value, axes, **options)


@singledispatch
def _plot(value: object, axes: Any) -> Any:
    raise TypeError(f"{type(value).__name__} has no plot.")


def _flat(axes: Any) -> Any:
    if axes is not None:
        return axes
    import matplotlib.pyplot as plt

    return plt.subplots(layout="constrained")[1]


def _in_space(axes: Any) -> Any:
    if axes is not None:
        return axes
    import matplotlib.pyplot as plt

    return plt.figure(layout="constrained").add_subplot(projection="3d")


@_plot.register(Rig)
@_plot.register(Feature)
@_plot.register(RefineResult)
def _(value: Any, axes: Any, **options: Any) -> Any:
    """Draw the 3-D figure of the report. Option `rig` : cameras to draw with features."""
    axes = _in_space(axes)
    figure = figure_in_space(value, **options)
    strokes = [
        (layer.parts, COLOUR_OF_ROLE.get(layer.role, BLACK))
        for layer in figure.layers
        if layer.shown and layer.role != "axes"
    ]
    plot.draw_lines_in_space(axes, strokes)
    ground = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}
    for label in figure.labels:
        if label.role != "axes":
            axes.text(*label.at_mm, label.text, ha="center", va="bottom", bbox=ground)
    return axes


@_plot.register
def _(pattern: Pattern, axes: Any) -> Any:
    from matplotlib.collections import LineCollection

    axes = _flat(axes)
    outlines = [outline[:, :2] for outline in sheet_outlines(pattern)]
    axes.add_collection(LineCollection(outlines, colors=BLUE, linewidths=1.0))
    axes.autoscale()
    axes.set_aspect("equal")
    axes.set(title=pattern.name, xlabel="X (mm)", ylabel="Y (mm)")
    return axes


@_plot.register
def _(
    result: CalibrationResult, axes: Any, *, images: Mapping[str, np.ndarray] | None = None
) -> Any:
    """Draw the residuals of each camera at one scale. axes : array with the axes of each camera."""
    if axes is None:
        import matplotlib.pyplot as plt

        count = max(len(result.fits), 1)
        size = (4.2 * count, 4.4)
        axes = plt.subplots(1, count, figsize=size, squeeze=False, layout="constrained")[1][0]
    longest = max(
        (
            float(np.abs(fit.residuals_px[fit.used]).max(initial=1e-12))
            for fit in result.fits.values()
        ),
        default=1.0,
    )
    for axis, (name, fit) in zip(axes, result.fits.items(), strict=False):
        width, height = fit.detection.image_size_px
        scale = round_scale(ARROW_SHARE * width / longest)
        blank = np.full((height, width), 255, np.uint8)
        picture = blank if images is None else images[name]
        plot.draw_detection(axis, picture, fit, magnification=scale)
        axis.set_title(f"{name}: residuals x {plain(scale)}, {fit.rms_px:.4f} px rms")
    return axes


@_plot.register
def _(segments: Segments, axes: Any, *, image: np.ndarray | None = None) -> Any:
    axes = _flat(axes)
    ends = np.asarray(segments.endpoints_px)
    plot.draw_segments(axes, _picture(image, segments.image_size_px, ends), segments)
    axes.set_title(f"{len(segments)} segments")
    return axes


def _picture(
    image: np.ndarray | None, size_px: tuple[int, int] | None, points_px: np.ndarray
) -> np.ndarray:
    """Return the image, or a white image if it is None.

    size_px : size of the white image; None for the smallest size that contains the points.
    """
    if image is not None:
        return image
    if size_px is None:
        size_px = tuple(
            (np.nanmax(points_px.reshape(-1, 2), 0, initial=1).astype(int) + 1).tolist()
        )
    return np.full(size_px[::-1], 255, np.uint8)


@_plot.register
def _(
    matches: Matches,
    axes: Any,
    *,
    rig: Rig | None = None,
    view: str | None = None,
    image: np.ndarray | None = None,
    stage: str = TRINOCULAR,
) -> Any:
    """Draw matches in space with the cameras of `rig`, or the tracks of one stage on the image of
    `view`.
    """
    if view is None:
        axes = _in_space(axes)
        plot.draw_space(axes, matches, rig)
        return axes
    axes = _flat(axes)
    fragments_px = np.asarray(matches.fragments_px)[:, matches.views.index(view)]
    plot.draw_tracks(axes, _picture(image, None, fragments_px), matches, view, stage)
    axes.set_title(f"{view}, {stage}")
    return axes


@_plot.register
def _(frame: Wireframe, axes: Any, *, rig: Rig | None = None) -> Any:
    """Draw a wire frame in space: edges by number of views, shaded faces, corners as dots."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    axes = _in_space(axes)
    lines = frame.lines_mm
    strokes = [
        (list(lines[frame.checked]), BLUE),
        (list(lines[~frame.checked]), VERMILION),
        ([] if rig is None else frusta(rig), GREEN),
    ]
    plot.draw_lines_in_space(axes, strokes)
    faces = [frame.vertices_mm[loop] for loop in frame.faces]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=BLUE, alpha=0.12))
    axes.scatter(*frame.vertices_mm[frame.corner].T, color=BLACK, s=9, depthshade=False)
    return axes


@_plot.register
def _(evaluation: Evaluation, axes: Any) -> Any:
    axes = _flat(axes)
    within = evaluation.tolerances_mm
    axes.plot(within, evaluation.precision, "o-", color=BLUE, label="precision")
    axes.plot(within, evaluation.completeness, "s--", color=VERMILION, label="completeness")
    axes.set(xlabel="within (mm)", ylabel="share of length", ylim=(0, 1.02), xscale="log")
    axes.legend()
    return axes
