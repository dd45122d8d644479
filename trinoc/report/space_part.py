"""The rig, the sheet and the 3-D segments as layers of lines, for a figure to turn; then plan and
elevation of the same, to scale, without any script.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.line_lengths import LineSigmas, line_sigmas
from trinoc.geometry.rig import Rig
from trinoc.match.line_map.collinear_merge import join_collinear
from trinoc.match.line_map.corners import snap_corners
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.report.numbers import plain, point_text, round_scale, with_decimals, with_sigma
from trinoc.report.space_content import Box, content_box, frusta, sheet_outlines, whole_box


class LineLayer(NamedTuple):
    """Lines of one kind, which the figure shows or hides together.

    Fields
    ------
    name : as the legend has it.
    role : what decides the colour: "three", "two", "bars", "joined", "corners", "sheet", "axes" or
        "cameras".
    parts : (n, 3) each, open lines in mm; one point alone is a dot.
    shown : whether the figure begins with it.
    tracks : the track of each part; empty where parts are none.
    descriptions : a sentence on each part; empty if there are none.
    """

    name: str
    role: str
    parts: list[np.ndarray]
    shown: bool = True
    tracks: tuple[int, ...] = ()
    descriptions: tuple[str, ...] = ()


class Label(NamedTuple):
    """A label at a point in space, coloured as its layer."""

    at_mm: np.ndarray
    text: str
    role: str


class SpaceView(NamedTuple):
    """A named box to fill the figure, and the azimuth of the eye, from X toward Y, in radians."""

    name: str
    box: Box
    azimuth: float = -1.15


class SpaceFigure(NamedTuple):
    """Everything that a figure in space needs; the first of `views` is the one to begin with."""

    layers: tuple[LineLayer, ...]
    labels: tuple[Label, ...]
    views: tuple[SpaceView, ...]

    @classmethod
    def of_tracks(cls, matches: Matches) -> "SpaceFigure":
        """The segments and their error bars alone."""
        content = content_box(None, matches)
        views = () if content is None else (SpaceView("Segments", content),)
        return cls(tuple(_track_layers(matches)), (), views)

    def join(self, more: "SpaceFigure") -> "SpaceFigure":
        """This figure with the layers, labels and views of another one added."""
        return SpaceFigure(
            self.layers + more.layers, self.labels + more.labels, self.views + more.views
        )

    def numbers(self) -> dict[str, Any]:
        """The figure as the page's script reads it, rounded to a micrometre."""
        return {
            "layers": [
                {
                    "role": layer.role,
                    "shown": layer.shown,
                    "parts": [np.round(part, 3).ravel().tolist() for part in layer.parts],
                    "tracks": list(layer.tracks),
                    "words": list(layer.descriptions),
                }
                for layer in self.layers
            ],
            "labels": [
                {"at": np.round(label.at_mm, 3).tolist(), "text": label.text, "role": label.role}
                for label in self.labels
            ],
            "views": [
                {
                    "low": np.round(view.box.low_mm, 3).tolist(),
                    "high": np.round(view.box.high_mm, 3).tolist(),
                    "azimuth": round(view.azimuth, 3),
                }
                for view in self.views
            ],
        }


def space_figure(rig: Rig, pattern: Pattern | None, matches: Matches | None) -> SpaceFigure:
    """Figure of a rig, a sheet and matches; its first view shows the segments, else the rig."""
    layers = []
    if matches is not None and len(matches):
        layers += _track_layers(matches)
        if matches.fragments_covariance_px2 is not None:
            layers += _joined_layers(matches, rig)
    if pattern is not None:
        layers.append(LineLayer("sheet", "sheet", sheet_outlines(pattern)))
    box = content_box(pattern, matches)
    axes = axes_in_space(0.25 * float(np.max(box.high_mm - box.low_mm)) if box else 50.0)
    views = _views(rig, box, matches is not None and len(matches) > 0)
    return SpaceFigure(tuple(layers), (), views).join(axes).join(cameras_in_space(rig))


def axes_in_space(reach_mm: float) -> SpaceFigure:
    """The world's axes with their letters."""
    parts = [np.stack([np.zeros(3), reach_mm * axis]) for axis in np.eye(3)]
    labels = tuple(
        Label(1.08 * part[1], axis, "axes") for part, axis in zip(parts, "XYZ", strict=True)
    )
    layer = LineLayer(f"world axes, {reach_mm:.0f} mm long", "axes", parts)
    return SpaceFigure((layer,), labels, ())


def cameras_in_space(rig: Rig) -> SpaceFigure:
    """The frusta of the cameras with their names."""
    labels = tuple(Label(camera.centre_world_mm, name, "cameras") for name, camera in rig.items())
    return SpaceFigure((LineLayer("cameras", "cameras", frusta(rig)),), labels, ())


def _track_layers(matches: Matches) -> list[LineLayer]:
    sigmas, stage = line_sigmas(matches.lines_mm, matches.covariance_mm2), np.asarray(matches.stage)
    layers = []
    for name, role, title in (
        (TRINOCULAR, "three", "seen in three or more views"),
        (BINOCULAR, "two", "seen in two views"),
    ):
        tracks = tuple(np.flatnonzero(stage == name).tolist())
        if tracks:
            parts = [np.asarray(matches.lines_mm[track]) for track in tracks]
            descriptions = tuple(describe_track(matches, sigmas, track) for track in tracks)
            title = f"{title} ({len(tracks)})"
            layers.append(LineLayer(title, role, parts, True, tracks, descriptions))
    layers.append(LineLayer("error bars (1 sigma)", "bars", _error_bars(matches), shown=False))
    return layers


def describe_track(matches: Matches, sigmas: LineSigmas, track: int) -> str:
    """Describe a track: its length, its ends, their sigmas, and its segments."""
    length = with_sigma(float(sigmas.length_mm[track]), float(sigmas.length_sigma_mm[track]))
    segments = ", ".join(
        f"{view} {index}"
        for view, index in zip(matches.views, np.asarray(matches.index[track]), strict=True)
        if index >= 0
    )
    ends = zip(matches.lines_mm[track].tolist(), sigmas.ends_sigma_mm[track].tolist(), strict=True)
    points = [f"end {number}: {point_text(*end)}" for number, end in enumerate(ends, 1)]
    across = with_decimals(float(sigmas.across_sigma_mm[track]), 3)
    posterior = with_decimals(float(matches.posterior[track]), 3)
    return (
        f"track {track}, {matches.stage[track]}: length {length} mm, sigma across {across} mm, "
        f"posterior {posterior}, segments {segments}. {'; '.join(points)} mm"
    )


def _error_bars(matches: Matches) -> list[np.ndarray]:
    """One sigma to both sides along the principal axes of each end's covariance."""
    parts = []
    for ends, covariance in zip(matches.lines_mm, matches.covariance_mm2, strict=True):
        for end, block in zip(ends, (covariance[:3, :3], covariance[3:, 3:]), strict=True):
            if np.isfinite(block).all():
                variances, axes = np.linalg.eigh(block)
                for variance, axis in zip(variances, axes.T, strict=True):
                    reach = np.sqrt(max(float(variance), 0.0)) * axis
                    parts.append(np.stack([end - reach, end + reach]))
    return parts


def _joined_layers(matches: Matches, rig: Rig) -> list[LineLayer]:
    """Layers for the joined lines, one line per group of collinear tracks, and for their corners.

    The layers are hidden when the page opens.
    """
    joined = join_collinear(matches, rig)
    corners = snap_corners(joined)
    descriptions = []
    for corner, (point, covariance) in enumerate(
        zip(corners.points_mm, corners.covariance_mm2, strict=True)
    ):
        members = (corners.corner == corner).sum()
        sigmas_mm = np.sqrt(np.diagonal(covariance))
        descriptions.append(
            f"corner of {members} lines: {point_text(point.tolist(), sigmas_mm.tolist())} mm"
        )
    return [
        LineLayer(
            f"collinear tracks joined ({len(joined)})", "joined", list(corners.lines_mm), False
        ),
        LineLayer(
            f"corners ({len(corners)})",
            "corners",
            [point[None] for point in np.asarray(corners.points_mm)],
            False,
            (),
            tuple(descriptions),
        ),
    ]


def _views(rig: Rig, content: Box | None, segments: bool) -> tuple[SpaceView, ...]:
    """The content near the world's origin, and everything with the cameras."""
    # From the side, so that no camera stands before what all of them look at.
    x, y, _ = np.mean([camera.centre_world_mm for _, camera in rig.items()], axis=0)
    rig_view = SpaceView("Whole rig", whole_box(rig, content), float(np.arctan2(y, x)) + 1.25)
    if content is None:
        return (rig_view,)
    if segments:
        return SpaceView("Segments", content), rig_view
    return rig_view, SpaceView("Sheet", content)


GRID_LINES = 6
# Height of a camera's name over the width of a drawing, and width of a letter over the height.
NAME_SHARE, LETTER_SHARE = 0.036, 0.6


class PlanPath(NamedTuple):
    """Drawn lines: the data of an SVG path, and the role that decides its look.

    track : of the line, -1 for none.
    """

    data: str
    role: str
    track: int = -1


class Tick(NamedTuple):
    """A grid line: its position on its axis, in drawing units, and its number in mm."""

    position: float
    text: str


class Drawing(NamedTuple):
    """One orthographic view, in mm, second axis upward (so negated for SVG)."""

    title: str
    horizontal: str
    vertical: str
    left: float
    top: float
    width: float
    height: float
    paths: tuple[PlanPath, ...]
    labels: tuple[tuple[float, float, str], ...]
    across: tuple[Tick, ...]
    upward: tuple[Tick, ...]

    @property
    def name_height(self) -> float:
        """Height of the labels in drawing units."""
        return NAME_SHARE * self.width


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
        PlanPath(" ".join(_path(part[:, list(axes)]) for part in parts), role, track)
        for parts, role, track in lines
        if parts
    )
    step = round_scale(float(np.max(box.high_mm - box.low_mm)) / GRID_LINES)
    name_height = NAME_SHARE * float(high[0] - low[0])
    return Drawing(
        title,
        horizontal,
        vertical,
        float(low[0]),
        float(-high[1]),
        float(high[0] - low[0]),
        float(high[1] - low[1]),
        paths,
        place_names(
            [(float(p[axes[0]]), float(-p[axes[1]]), name) for p, name in names],
            name_height,
            # The words stand a line above their place.
            2 * name_height - float(high[1]),
        ),
        _ticks(float(low[0]), float(high[0]), step, 1),
        _ticks(float(low[1]), float(high[1]), step, -1),
    )


def place_names(
    names: Sequence[tuple[float, float, str]], height: float, top: float
) -> tuple[tuple[float, float, str], ...]:
    """Positions of names that do not overlap: each is moved up or down to the nearest free height.

    names : x, y downward, and the text, in letters of this height. top : upper limit of positions.
    """
    labels: list[tuple[float, float, str]] = []
    for x, y, name in names:
        steps = (sign * k * height for k in range(2 * len(labels) + 1) for sign in (-1, 1))
        free = (
            y + step
            for step in steps
            if (step == 0.0 or y + step > top)
            and not any(
                abs(x - u) < LETTER_SHARE * height * (len(name) + len(other)) / 2
                and abs(y + step - v) < 0.99 * height
                for u, v, other in labels
            )
        )
        labels.append((x, next(free, y), name))
    return tuple(labels)


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
