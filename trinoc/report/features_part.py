"""Features in space of any kind: layers of lines for a figure, a table, and text."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from trinoc.geometry.features import Feature
from trinoc.geometry.rig import Rig
from trinoc.match.wire_frame.frame import Wireframe
from trinoc.report.numbers import in_words, point_text, with_decimals, with_sigma
from trinoc.report.report_table import ReportTable
from trinoc.report.space_content import Box
from trinoc.report.space_part import LineLayer, SpaceFigure, SpaceView, cameras_in_space

# Room about the features, as a share of their extent.
ROOM = 0.1
_UNITS = ("mm", "px")


def features_figure(features: Feature, rig: Rig | None = None) -> SpaceFigure:
    """3-D figure of features and, if `rig` is given, of its cameras."""
    figure = SpaceFigure(tuple(features_layers(features)), (), ())
    if rig is not None:
        figure = figure.join(cameras_in_space(rig))
    points_mm = features.wires().points_mm
    if len(points_mm) == 0:
        return figure
    name = features.IN_WORDS.removeprefix("a ").capitalize()
    return figure._replace(views=(SpaceView(name, Box.around(points_mm, ROOM)),))


def with_features(figure: SpaceFigure, kinds: Iterable[Feature]) -> SpaceFigure:
    """Add layers of features to a 3-D figure of the segments."""
    layers = tuple(layer for features in kinds for layer in features_layers(features))
    return figure.join(SpaceFigure(layers, (), ()))


def features_layers(features: Feature) -> list[LineLayer]:
    """Layers of lines that show features in a 3-D figure, with descriptions.

    A wire frame has several layers, other features have one.
    """
    if isinstance(features, Wireframe):
        return wireframe_layers(features)
    if not len(features):
        return []
    rows, lines = zip(*features.wires().lines(), strict=True)
    of_feature = describe_features(features)
    descriptions = tuple(of_feature[row] for row in rows)
    name = f"{features.IN_WORDS} ({len(features)})"
    return [LineLayer(name, "joined", list(lines), True, (), descriptions)]


def describe_features(features: Feature) -> list[str]:
    """Describe each feature: its numbers with their sigmas, and the segments that show it."""
    return [_describe(features, *item) for item in enumerate(list_numbers(features))]


def _describe(features: Feature, row: int, values: dict[str, str]) -> str:
    parts = [f"{name} {value}" for name, value in values.items()]
    segments = "; ".join(
        f"{view} {', '.join(map(str, numbers.tolist()))}"
        for view, numbers in features.segments_of(row).items()
        if len(numbers)
    )
    parts += [f"segments {segments}"] if segments else []
    return f"{features.KIND.removesuffix('s')} {row}: {', '.join(parts)}"


def list_numbers(features: Feature) -> list[dict[str, str]]:
    """Most important columns of each feature, as text by column name."""
    numbers: list[dict[str, str]] = [{} for _ in range(len(features))]
    for column in features.READ_FIRST:
        stem, unit = _split_unit(column)
        values = np.asarray(getattr(features, column)).tolist()
        sigmas = getattr(features, f"{stem}_sigma{unit and '_' + unit}", None)
        texts = [with_decimals(float(value), 3) for value in values]
        if sigmas is not None:
            pairs = zip(values, np.asarray(sigmas).tolist(), strict=True)
            texts = [with_sigma(float(value), float(sigma)) for value, sigma in pairs]
        for each, text in zip(numbers, texts, strict=True):
            each[in_words(stem)] = f"{text} {unit}".strip()
    return numbers


def feature_table(features: Feature) -> ReportTable:
    """Table with a row for each feature: the most important columns and the number of segments."""
    numbers = list_numbers(features)
    head = (features.KIND.removesuffix("s"), *(numbers[0] if numbers else ()), "segments")
    counts = [sum(map(len, features.segments_of(row).values())) for row in range(len(features))]
    rows = [[str(k), *values.values(), str(counts[k])] for k, values in enumerate(numbers)]
    return ReportTable(head, rows)


def features_text(features: Feature) -> str:
    """Features as text: a sentence about all features, and a line for each."""
    lines = describe_features(features) if features.READ_FIRST else []
    return "\n".join([features.summary(), *lines])


def features_record(features: Feature) -> dict[str, Any]:
    """Features as a JSON object."""
    record: dict[str, Any] = {}
    if features.READ_FIRST:
        columns = {
            name: np.asarray(column)
            for name, column in features.rows().items()
            if "covariance" not in name
        }
        columns |= {name: np.asarray(getattr(features, name)) for name in features.DERIVED}
        record["found"] = [
            {name: column[row].tolist() for name, column in columns.items()}
            | {"segments": {v: s.tolist() for v, s in features.segments_of(row).items()}}
            for row in range(len(features))
        ]
    return {**record, **features.record()}


def _split_unit(column: str) -> tuple[str, str]:
    stem, _, last = column.rpartition("_")
    return (stem, last) if last in _UNITS else (column, "")


# Faces are drawn a little smaller, so that their edges stay visible.
INSET = 0.93


def wireframe_layers(frame: Wireframe) -> list[LineLayer]:
    """Layers of the edges, faces and vertices of a wire frame.

    Edges and vertices have descriptions with their sigmas.
    """
    lines, points = frame.lines_mm, frame.vertices_mm
    layers = []
    for checked, role, name in (
        (True, "three", "edges seen in three or more views"),
        (False, "two", "edges seen in two views"),
    ):
        rows = np.flatnonzero(frame.checked == checked).tolist()
        if rows:
            descriptions = tuple(describe_edge(frame, edge) for edge in rows)
            parts = [lines[edge] for edge in rows]
            layers.append(LineLayer(f"{name} ({len(rows)})", role, parts, True, (), descriptions))
    if len(frame.planes):
        parts = [_outline(points[loop]) for loop in frame.faces]
        layers.append(LineLayer(f"planar faces ({len(parts)})", "sheet", parts))
    for corner, name in ((True, "corners"), (False, "free ends")):
        rows = np.flatnonzero(frame.corner == corner).tolist()
        if rows:
            descriptions = tuple(_describe_vertex(frame, vertex) for vertex in rows)
            parts = [points[vertex][None] for vertex in rows]
            layers.append(
                LineLayer(f"{name} ({len(rows)})", "ellipsoids", parts, corner, (), descriptions)
            )
    return layers


def _outline(corners_mm: np.ndarray) -> np.ndarray:
    centre = corners_mm.mean(axis=0)
    closed = np.concatenate([corners_mm, corners_mm[:1]])
    return centre + INSET * (closed - centre)


def describe_edge(frame: Wireframe, edge: int) -> str:
    """Describe an edge: its length with its sigma, its posterior and its tracks."""
    first, second = frame.vertices_mm[frame.edges[edge]]
    length = float(np.linalg.norm(second - first))
    # Derivative of the length by both ends.
    gradient = np.concatenate([first - second, second - first]) / max(length, np.finfo(float).tiny)
    variance = gradient @ frame.covariance_of(frame.edges[edge]) @ gradient
    posterior = with_decimals(float(frame.posterior[edge]), 3)
    tracks = ", ".join(map(str, frame.tracks_of(edge).tolist()))
    return (
        f"edge {edge}: length {with_sigma(length, float(np.sqrt(max(variance, 0.0))))} mm, "
        f"posterior {posterior}, {frame.views[edge]} views, tracks {tracks}"
    )


def _describe_vertex(frame: Wireframe, vertex: int) -> str:
    sigmas_mm = np.sqrt(np.diagonal(frame.covariance_of([vertex])))
    kind = "corner" if frame.corner[vertex] else "free end"
    point = point_text(frame.vertices_mm[vertex].tolist(), sigmas_mm.tolist())
    return f"{kind} {vertex} of {len(frame.edges_at(vertex))} edges: {point} mm"
