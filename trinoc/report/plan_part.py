"""Plan and elevation: the same content as the figure to turn, to scale, without any script."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trinoc.report.numbers import plain, round_scale
from trinoc.report.space_content import Box
from trinoc.report.space_part import SpaceFigure

GRID_LINES = 6


class Path(NamedTuple):
    """Drawn lines: the data of an SVG path, and the role that decides its look.

    track : of the line, -1 for none.
    """

    data: str
    role: str
    track: int = -1


class Tick(NamedTuple):
    """A grid line: where it stands on its axis, in drawing units, and its number in mm."""

    at: float
    words: str


class Drawing(NamedTuple):
    """One orthographic view, in mm, second axis upward (so negated for SVG)."""

    title: str
    horizontal: str
    vertical: str
    left: float
    top: float
    width: float
    height: float
    paths: tuple[Path, ...]
    labels: tuple[tuple[float, float, str], ...]
    across: tuple[Tick, ...]
    upward: tuple[Tick, ...]


def draw_plans(figure: SpaceFigure) -> tuple[Drawing, ...]:
    """Plan (X, Y) and elevation (X, Z) of the segments, or of the rig where there are none."""
    tracks = [layer for layer in figure.layers if layer.tracks]
    cameras = [layer for layer in figure.layers if layer.role == "cameras" and not tracks]
    paths: list[tuple[list[np.ndarray], str, int]] = [
        (layer.parts, layer.role, -1)
        for layer in [*(layer for layer in figure.layers if layer.role == "sheet"), *cameras]
    ]
    for layer in tracks:
        paths += [
            ([part], layer.role, t) for part, t in zip(layer.parts, layer.tracks, strict=True)
        ]
    names = [(label.at_mm, label.text) for label in figure.labels if label.role == "cameras"]
    names, box = [] if tracks else names, figure.views[0].box
    return (
        _drawing("Plan, seen from above", "X", "Y", (0, 1), box, paths, names),
        _drawing("Elevation, seen from the front", "X", "Z", (0, 2), box, paths, names),
    )


def _drawing(
    title: str,
    horizontal: str,
    vertical: str,
    axes: tuple[int, int],
    box: Box,
    lines: Sequence[tuple[list[np.ndarray], str, int]],
    names: Sequence[tuple[np.ndarray, str]],
) -> Drawing:
    low, high = box.low_mm[list(axes)], box.high_mm[list(axes)]
    paths = tuple(
        Path(" ".join(_path(part[:, list(axes)]) for part in parts), role, track)
        for parts, role, track in lines
        if parts
    )
    step = round_scale(float(np.max(box.high_mm - box.low_mm)) / GRID_LINES)
    return Drawing(
        title,
        horizontal,
        vertical,
        float(low[0]),
        float(-high[1]),
        float(high[0] - low[0]),
        float(high[1] - low[1]),
        paths,
        tuple((float(p[axes[0]]), float(-p[axes[1]]), name) for p, name in names),
        _ticks(float(low[0]), float(high[0]), step, 1),
        _ticks(float(low[1]), float(high[1]), step, -1),
    )


def _path(points: np.ndarray) -> str:
    if not np.isfinite(points).all():
        return ""
    return "M" + "L".join(f"{x:.2f} {-y:.2f}" for x, y in points.tolist())


def _ticks(low: float, high: float, step: float, sign: int) -> tuple[Tick, ...]:
    numbers = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    return tuple(
        Tick(sign * value, plain(value).replace("-", "\N{MINUS SIGN}"))
        for value in (numbers + 0.0).tolist()
    )
