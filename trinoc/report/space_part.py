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
    """Lines of one kind, which a 3-D figure shows or hides together.

    Attributes
    ----------
    name : str
        Name in the legend.
    role : str
        Kind that determines the colour: "three", "two", "bars", "joined", "corners", "sheet",
        "axes" or "cameras".
    parts : list of (n, 3)
        Open lines in mm; a single point is drawn as a dot.
    shown : bool
        True if the layer is visible when the page opens.
    tracks : tuple of int
        Index of the track of each part; empty if the parts are not tracks.
    descriptions : tuple of str
        Sentence on each part; may be empty.
    """

    name: str
    role: str
    parts: list[np.ndarray]
    shown: bool = True
    tracks: tuple[int, ...] = ()
    descriptions: tuple[str, ...] = ()


class Label(NamedTuple):
    """Label at a point in space, mm. `role` determines the colour, as in `LineLayer`."""

    at_mm: np.ndarray
    text: str
    role: str


class SpaceView(NamedTuple):
    """Named view of a 3-D figure.

    Attributes
    ----------
    name : str
        Name on the page.
    box : Box
        Box that fills the figure.
    azimuth : float
        Azimuth of the viewpoint, radians from X toward Y.
    """

    name: str
    box: Box
    azimuth: float = -1.15


class SpaceFigure(NamedTuple):
    """3-D figure: layers of lines, labels, and named views. The page opens with the first view."""

    layers: tuple[LineLayer, ...]
    labels: tuple[Label, ...]
    views: tuple[SpaceView, ...]

    @classmethod
    def of_tracks(cls, matches: Matches) -> "SpaceFigure":
        """3-D figure of the segments and their error bars, without cameras."""
        content = content_box(None, matches)
        views = () if content is None else (SpaceView("Segments", content),)
        return cls(tuple(_track_layers(matches)), (), views)

    def join(self, more: "SpaceFigure") -> "SpaceFigure":
        """Return this figure with the layers, labels and views of `more` added."""
        return SpaceFigure(
            self.layers + more.layers, self.labels + more.labels, self.views + more.views
        )

    def numbers(self) -> dict[str, Any]:
        """Figure as numbers for the page's script, rounded to a micrometre."""
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
    """3-D figure of a rig, a sheet and matches.

    The page opens with a view of the segments, or of the rig without segments.
    """
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
    """3-D figure of the world's axes with their names. reach_mm : length of the axes."""
    parts = [np.stack([np.zeros(3), reach_mm * axis]) for axis in np.eye(3)]
    labels = tuple(
        Label(1.08 * part[1], axis, "axes") for part, axis in zip(parts, "XYZ", strict=True)
    )
    layer = LineLayer(f"world axes, {reach_mm:.0f} mm long", "axes", parts)
    return SpaceFigure((layer,), labels, ())


def cameras_in_space(rig: Rig) -> SpaceFigure:
    """3-D figure of the cameras' viewing frusta with their names."""
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
    """Error bars of the ends: lines of one sigma to both sides along the principal axes of the
    covariance.
    """
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
    """Two layers, hidden when the page opens: joined lines, and the corners where they meet.

    A joined line is the union of collinear tracks. Its ends are moved to corners.
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
    """Named views of the content and of the rig. segments : True if there are 3-D segments."""
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
    """Lines of a drawing.

    Attributes
    ----------
    data : str
        Data of an SVG path.
    role : str
        Kind that determines the colour, as in `LineLayer`.
    track : int
        Index of the track; -1 for none.
    """

    data: str
    role: str
    track: int = -1


class Tick(NamedTuple):
    """Grid line of a drawing: position on its axis in drawing units, coordinate in mm as text."""

    position: float
    text: str


class Drawing(NamedTuple):
    """Orthographic drawing of a 3-D figure, in mm. SVG's y axis points down, so y is negated.

    Attributes
    ----------
    title : str
        Title.
    horizontal, vertical : str
        Names of the world axes.
    left, top, width, height : float
        Region of the drawing.
    paths : tuple of PlanPath
        Lines.
    labels : tuple of (x, y, text)
        Names of cameras.
    across, upward : tuple of Tick
        Grid lines of the horizontal and the vertical axis.
    """

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
    """Drawings of a 3-D figure: plan (X, Y) and elevation (X, Z).

    They show the segments, or the rig if there are no segments.
    """
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
    """Move names up or down to the nearest height at which no two names overlap.

    names : x, y (downward) and text of each name. height : height of the letters.
    top : upper limit of the new positions.
    """
    labels: list[tuple[float, float, str]] = []
    for x, y, name in names:
        steps = (sign * k * height for k in range(2 * len(labels) + 1) for sign in (-1, 1))
        free_heights = (
            y + step
            for step in steps
            if (step == 0.0 or y + step > top)
            and not any(
                abs(x - u) < LETTER_SHARE * height * (len(name) + len(other)) / 2
                and abs(y + step - v) < 0.99 * height
                for u, v, other in labels
            )
        )
        labels.append((x, next(free_heights, y), name))
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
