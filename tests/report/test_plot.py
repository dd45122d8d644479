"""Static figures draw every value on the axes, in pixels of the picture."""

from collections.abc import Iterator

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from trinoc.calib import CalibrationResult
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches
from trinoc.report import plot

matplotlib.use("Agg")

from matplotlib import pyplot as plt


@pytest.fixture
def axes() -> Iterator[Axes]:
    figure, axes = plt.subplots()
    yield axes
    figure.canvas.draw()
    plt.close(figure)


def _lines(axes: Axes) -> list[int]:
    return [len(c.get_segments()) for c in axes.collections if isinstance(c, LineCollection)]


def test_a_detection(
    axes: Axes, result: CalibrationResult, sheet_pictures: dict[str, np.ndarray]
) -> None:
    fit = result.fits["left"]
    plot.draw_detection(axes, sheet_pictures["left"], fit, magnification=1000)
    assert _lines(axes) == [len(fit.detection), 2]
    outlines = axes.collections[0]
    assert isinstance(outlines, LineCollection)
    for outline, centre, shape in zip(
        outlines.get_segments(), fit.detection.centres_px, fit.detection.shape_px2, strict=True
    ):
        offset = np.asarray(outline) - centre
        form = np.einsum("ni,ij,nj->n", offset, np.linalg.inv(shape), offset)
        np.testing.assert_allclose(form, 1.0, rtol=1e-9)


def test_segments_and_tracks(
    axes: Axes,
    segments: dict[str, Segments],
    matches: Matches,
    scene_pictures: dict[str, np.ndarray],
) -> None:
    plot.draw_segments(axes, scene_pictures["upper"], segments["upper"])
    assert _lines(axes) == [len(segments["upper"])]
    axes.clear()
    for stage in ("trinocular", "binocular"):
        plot.draw_tracks(axes, scene_pictures["upper"], matches, "upper", stage)
    assert sum(_lines(axes)) == int((matches.index[:, 0] >= 0).sum())


def test_space_has_equal_axes(matches: Matches, rig: Rig) -> None:
    figure = plt.figure()
    axes = figure.add_subplot(projection="3d")
    plot.draw_space(axes, matches, rig)
    spans = [np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())]
    shape = np.asarray(axes.get_box_aspect() if hasattr(axes, "get_box_aspect") else spans)
    np.testing.assert_allclose(shape / shape[0], np.divide(spans, spans[0]), rtol=1e-6)
    figure.canvas.draw()
    plt.close(figure)
