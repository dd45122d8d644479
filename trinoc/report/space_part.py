"""The rig, the sheet and the 3-D segments: a figure to turn, in mm with equal axes."""

import html
from typing import Any

import numpy as np
from jaxtyping import Float

from trinoc.calib import Pattern
from trinoc.geometry import Rig
from trinoc.match import BINOCULAR, TRINOCULAR, Matches, join_collinear, snap_corners
from trinoc.report.colours import BLACK, BLUE, GREEN, VERMILION
from trinoc.report.numbers import with_decimals, with_sigma
from trinoc.report.space_content import (
    Box,
    content_box,
    frusta,
    polyline,
    sheet_outlines,
    whole_box,
)
from trinoc.report.track_sigmas import TrackSigmas, track_sigmas

# In plotly's own unit of length; with less for a tall box, every view fills the figure alike.
BOX_DIAGONAL = 2.1


def space_figure(rig: Rig, pattern: Pattern | None, matches: Matches | None) -> dict[str, Any]:
    """The figure as plotly's JSON. Its first view holds the segments, or the rig without any."""
    traces: list[dict[str, Any]] = []
    if matches is not None and len(matches):
        sigmas = track_sigmas(matches)
        for stage, colour in ((TRINOCULAR, BLUE), (BINOCULAR, VERMILION)):
            tracks = np.flatnonzero(np.asarray(matches.stage) == stage)
            if len(tracks):
                traces.append(_segments_trace(matches, sigmas, tracks, stage, colour))
        traces.append(_error_bars(matches))
        if matches.fragments_covariance_px2 is not None:
            traces.extend(_joined_traces(matches, rig))
    if pattern is not None:
        traces.append(_lines("sheet", sheet_outlines(pattern), "#777777", 2))
    traces.append(_axes(pattern, matches))
    traces.append(_lines("cameras", frusta(rig), GREEN, 3))
    traces.append(_camera_names(rig))
    views = _views(rig, pattern, matches)
    return {"data": traces, "layout": _layout(views)}


def _lines(name: str, parts: list[np.ndarray], colour: str, width: int) -> dict[str, Any]:
    points = polyline(parts)
    return _trace(
        points,
        mode="lines",
        name=name,
        line={"color": colour, "width": width},
        hoverinfo="skip",
    )


def _segments_trace(
    matches: Matches, sigmas: TrackSigmas, tracks: np.ndarray, stage: str, colour: str
) -> dict[str, Any]:
    parts, words = [], []
    for track in tracks.tolist():
        ends = np.asarray(matches.lines_mm[track])
        parts.append(np.stack([ends[0], ends.mean(axis=0), ends[1]]))
        words.extend([*_hover(matches, sigmas, track), ""])
    points = polyline(parts)
    return _trace(
        points,
        text=words,
        mode="lines",
        name=f"{stage} ({len(tracks)})",
        line={"color": colour, "width": 5},
        hovertemplate="%{text}<extra></extra>",
    )


def _hover(matches: Matches, sigmas: TrackSigmas, track: int) -> list[str]:
    """The words at the first end, the middle and the second end of a track."""
    length = with_sigma(float(sigmas.length_mm[track]), float(sigmas.length_sigma_mm[track]))
    seen = ", ".join(
        f"{_plain(view)} {index}"
        for view, index in zip(matches.views, np.asarray(matches.index[track]), strict=True)
        if index >= 0
    )
    head = (
        f"track {track}, {matches.stage[track]}<br>length {length} mm<br>"
        f"posterior {with_decimals(float(matches.posterior[track]), 3)}<br>segments {seen}"
    )
    ends = [
        head
        + "".join(
            f"<br>{axis} {with_sigma(float(value), float(sigma))} mm"
            for axis, value, sigma in zip("XYZ", point, sigma_mm, strict=True)
        )
        for point, sigma_mm in zip(
            np.asarray(matches.lines_mm[track]), sigmas.ends_sigma_mm[track], strict=True
        )
    ]
    across = with_decimals(float(sigmas.across_sigma_mm[track]), 3)
    return [ends[0], f"{head}<br>across the segment: sigma {across} mm", ends[1]]


def _error_bars(matches: Matches) -> dict[str, Any]:
    """One sigma to both sides along the principal axes of each end's covariance."""
    parts = []
    for ends, covariance in zip(matches.lines_mm, matches.covariance_mm2, strict=True):
        for end, block in zip(ends, (covariance[:3, :3], covariance[3:, 3:]), strict=True):
            if np.isfinite(block).all():
                variances, axes = np.linalg.eigh(block)
                for variance, axis in zip(variances, axes.T, strict=True):
                    reach = np.sqrt(max(float(variance), 0.0)) * axis
                    parts.append(np.stack([end - reach, end + reach]))
    points = polyline(parts or [np.full((1, 3), np.nan)])
    return _trace(
        points,
        mode="lines",
        name="error bars (1 sigma)",
        visible="legendonly",
        line={"color": BLACK, "width": 3},
        hoverinfo="skip",
    )


def _joined_traces(matches: Matches, rig: Rig) -> list[dict[str, Any]]:
    """Collinear tracks as one line each, and the corners where lines meet; hidden at first."""
    joined = join_collinear(matches, rig)
    corners = snap_corners(joined)
    words = []
    for corner, (point, covariance) in enumerate(
        zip(corners.points_mm, corners.covariance_mm2, strict=True)
    ):
        members = (corners.corner == corner).sum()
        sigmas = np.sqrt(np.diagonal(covariance))
        words.append(
            f"corner of {members} lines"
            + "".join(
                f"<br>{axis} {with_sigma(float(value), float(sigma))} mm"
                for axis, value, sigma in zip("XYZ", point, sigmas, strict=True)
            )
        )
    lines = _trace(
        polyline(list(corners.lines_mm) or [np.full((1, 3), np.nan)]),
        mode="lines",
        name=f"collinear tracks joined ({len(joined)} lines)",
        visible="legendonly",
        line={"color": BLACK, "width": 3},
        hoverinfo="skip",
    )
    points = _trace(
        corners.points_mm,
        text=words,
        mode="markers",
        name=f"corners ({len(corners)})",
        visible="legendonly",
        marker={"color": BLACK, "size": 3},
        hovertemplate="%{text}<extra></extra>",
    )
    return [lines, points]


def _axes(pattern: Pattern | None, matches: Matches | None) -> dict[str, Any]:
    box = content_box(pattern, matches)
    reach = 0.25 * float(np.max(box.high_mm - box.low_mm)) if box else 50.0
    points = polyline([np.stack([np.zeros(3), reach * axis]) for axis in np.eye(3)])
    labels = ["", "X", "", "", "Y", "", "", "Z", ""]
    return _trace(
        points,
        text=labels,
        mode="lines+text",
        name="world axes",
        line={"color": BLACK, "width": 4},
        textfont={"color": BLACK, "size": 15},
        hoverinfo="skip",
    )


def _camera_names(rig: Rig) -> dict[str, Any]:
    centres = np.stack([camera.centre_world_mm for _, camera in rig.items()])
    words = [
        f"{_plain(name)}<br>centre ({', '.join(with_decimals(float(x), 2) for x in centre)}) mm"
        for name, centre in zip(rig, centres, strict=True)
    ]
    return _trace(
        centres,
        text=[_plain(name) for name in rig],
        customdata=words,
        hovertemplate="%{customdata}<extra></extra>",
        mode="markers+text",
        textposition="top center",
        showlegend=False,
        name="camera names",
        marker={"color": GREEN, "size": 4},
        textfont={"color": BLACK, "size": 14},
    )


def _views(rig: Rig, pattern: Pattern | None, matches: Matches | None) -> list[tuple[str, Box]]:
    """Named boxes: the content near the world's origin, and everything with the cameras."""
    content = content_box(pattern, matches)
    whole = ("Whole rig", whole_box(rig, content))
    if content is None or matches is None or not len(matches):
        return [whole] if content is None else [whole, ("Sheet", content)]
    return [("Segments", content), whole]


def _scene(box: Box) -> dict[str, Any]:
    """Ranges and ratios of equal axes: one millimetre is as long along X, Y and Z."""
    size = box.high_mm - box.low_mm
    tallness = float(size[2] / np.max(size))
    ratio = size / float(np.linalg.norm(size)) * BOX_DIAGONAL / (1 + 0.5 * tallness)
    return {
        "scene.xaxis.range": [float(box.low_mm[0]), float(box.high_mm[0])],
        "scene.yaxis.range": [float(box.low_mm[1]), float(box.high_mm[1])],
        "scene.zaxis.range": [float(box.low_mm[2]), float(box.high_mm[2])],
        "scene.aspectratio": dict(zip("xyz", ratio.tolist(), strict=True)),
    }


def _layout(views: list[tuple[str, Box]]) -> dict[str, Any]:
    axis = {
        "backgroundcolor": "#fbfbf9",
        "gridcolor": "#dddddd",
        "zerolinecolor": "#bbbbbb",
        "showbackground": True,
    }
    first = _scene(views[0][1])
    return {
        "scene": {
            "xaxis": {**axis, "title": {"text": "X (mm)"}, "range": first["scene.xaxis.range"]},
            "yaxis": {**axis, "title": {"text": "Y (mm)"}, "range": first["scene.yaxis.range"]},
            "zaxis": {**axis, "title": {"text": "Z (mm)"}, "range": first["scene.zaxis.range"]},
            "aspectmode": "manual",
            "aspectratio": first["scene.aspectratio"],
            "camera": {
                "eye": {"x": 0.5, "y": -1.45, "z": 0.95},
                "center": {"x": 0, "y": 0, "z": -0.15},
            },
            "dragmode": "turntable",
        },
        "font": {"family": "system-ui, sans-serif", "size": 13, "color": "#222222"},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 0, "r": 0, "t": 46, "b": 40},
        "legend": {"orientation": "h", "y": 0.0, "yanchor": "top", "x": 0.5, "xanchor": "center"},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#888888", "activecolor": "#222222"},
        "updatemenus": [
            {
                "type": "buttons",
                "direction": "right",
                "x": 0.0,
                "y": 1.0,
                "xanchor": "left",
                "yanchor": "bottom",
                "pad": {"t": 0, "b": 6},
                "buttons": [
                    {"label": label, "method": "relayout", "args": [_scene(box)]}
                    for label, box in views
                ],
            }
        ],
    }


def _trace(points_mm: Float[np.ndarray, "n 3"], **look: Any) -> dict[str, Any]:
    """Points in space as plotly has them: rounded to a micrometre, a line broken at null."""
    x, y, z = (
        [round(value, 3) if np.isfinite(value) else None for value in column.tolist()]
        for column in points_mm.T
    )
    return {"type": "scatter3d", "x": x, "y": y, "z": z, **look}


def _plain(words: str) -> str:
    """A name that plotly shows as it is, without reading tags into it."""
    return html.escape(words, quote=False)
