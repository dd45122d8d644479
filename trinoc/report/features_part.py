"""Features in space of any kind: as lines to turn, as a table, and in words."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from trinoc.geometry.features import Feature
from trinoc.geometry.rig import Rig
from trinoc.match.wire_frame.frame import Wireframe
from trinoc.report.numbers import in_words, with_decimals, with_sigma
from trinoc.report.report_table import ReportTable
from trinoc.report.space_content import Box
from trinoc.report.space_part import LineLayer, SpaceFigure, SpaceView, cameras_in_space

# Room about the features, as a share of their extent.
ROOM = 0.1
_UNITS = ("mm", "px")


def features_figure(features: Feature, rig: Rig | None = None) -> SpaceFigure:
    """The features, and the cameras of `rig`."""
    figure = SpaceFigure(tuple(features_layers(features)), (), ())
    if rig is not None:
        figure = figure.join(cameras_in_space(rig))
    places = features.wires().places_mm
    if len(places) == 0:
        return figure
    name = features.IN_WORDS.removeprefix("a ").capitalize()
    return figure._replace(views=(SpaceView(name, Box.around(places, ROOM)),))


def with_features(figure: SpaceFigure, kinds: Iterable[Feature]) -> SpaceFigure:
    """A figure of the segments, and features in it."""
    more = tuple(layer for features in kinds for layer in features_layers(features))
    return figure.join(SpaceFigure(more, (), ()))


def features_layers(features: Feature) -> list[LineLayer]:
    """One layer of the lines of all of them, with words; a wire frame has more."""
    if isinstance(features, Wireframe):
        return wireframe_layers(features)
    if not len(features):
        return []
    rows, lines = zip(*features.wires().lines(), strict=True)
    every = list_words(features)
    words = tuple(every[row] for row in rows)
    name = f"{features.IN_WORDS} ({len(features)})"
    return [LineLayer(name, "joined", list(lines), True, (), words)]


def list_words(features: Feature) -> list[str]:
    """What is known of each of them: its numbers with their sigmas, and where it is seen."""
    return [_words(features, *item) for item in enumerate(list_numbers(features))]


def _words(features: Feature, row: int, values: dict[str, str]) -> str:
    numbers = [f"{name} {value}" for name, value in values.items()]
    seen = "; ".join(
        f"{view} {', '.join(map(str, own.tolist()))}"
        for view, own in features.segments_of(row).items()
        if len(own)
    )
    whole = ", ".join([*numbers, *([f"segments {seen}"] if seen else [])])
    return f"{features.KIND.removesuffix('s')} {row}: {whole}"


def list_numbers(features: Feature) -> list[dict[str, str]]:
    """By name, what people read first of each feature."""
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
    """A row for each feature: the columns that people read first, and its number of segments."""
    numbers = list_numbers(features)
    head = (features.KIND.removesuffix("s"), *(numbers[0] if numbers else ()), "segments")
    counts = [sum(map(len, features.segments_of(row).values())) for row in range(len(features))]
    rows = [[str(k), *values.values(), str(counts[k])] for k, values in enumerate(numbers)]
    return ReportTable(head, rows)


def features_text(features: Feature) -> str:
    """A sentence, and a line for each, for people."""
    return "\n".join([features.summary(), *(list_words(features) if features.READ_FIRST else [])])


def features_record(features: Feature) -> dict[str, Any]:
    """What programs want to know of them, as JSON can hold it."""
    own: dict[str, Any] = {}
    if features.READ_FIRST:
        columns = {
            name: np.asarray(column)
            for name, column in features.rows().items()
            if "covariance" not in name
        }
        columns |= {name: np.asarray(getattr(features, name)) for name in features.DERIVED}
        own["found"] = [
            {name: column[row].tolist() for name, column in columns.items()}
            | {"segments": {v: s.tolist() for v, s in features.segments_of(row).items()}}
            for row in range(len(features))
        ]
    return {**own, **features.record()}


def _split_unit(column: str) -> tuple[str, str]:
    stem, _, last = column.rpartition("_")
    return (stem, last) if last in _UNITS else (column, "")


# Faces are drawn within their edges, so that both are seen.
INSET = 0.93


def wireframe_layers(frame: Wireframe) -> list[LineLayer]:
    """Layers of what there is; edges and corners say how well they are known."""
    lines, points = frame.lines_mm, frame.vertices_mm
    layers = []
    for checked, role, said in (
        (True, "three", "edges seen in three or more views"),
        (False, "two", "edges seen in two views"),
    ):
        chosen = np.flatnonzero(frame.checked == checked).tolist()
        if chosen:
            words = tuple(edge_words(frame, edge) for edge in chosen)
            parts = [lines[edge] for edge in chosen]
            layers.append(LineLayer(f"{said} ({len(chosen)})", role, parts, True, (), words))
    if len(frame.planes):
        parts = [_outline(points[loop]) for loop in frame.faces]
        layers.append(LineLayer(f"planar faces ({len(parts)})", "sheet", parts))
    for corner, said in ((True, "corners"), (False, "free ends")):
        chosen = np.flatnonzero(frame.corner == corner).tolist()
        if chosen:
            words = tuple(_vertex_words(frame, vertex) for vertex in chosen)
            parts = [points[vertex][None] for vertex in chosen]
            layers.append(
                LineLayer(f"{said} ({len(chosen)})", "ellipsoids", parts, corner, (), words)
            )
    return layers


def _outline(corners_mm: np.ndarray) -> np.ndarray:
    centre = corners_mm.mean(axis=0)
    closed = np.concatenate([corners_mm, corners_mm[:1]])
    return centre + INSET * (closed - centre)


def edge_words(frame: Wireframe, edge: int) -> str:
    """What is known of an edge: its length, its posterior, the tracks that it is from."""
    first, second = frame.vertices_mm[frame.edges[edge]]
    length = float(np.linalg.norm(second - first))
    way = np.concatenate([first - second, second - first]) / max(length, np.finfo(float).tiny)
    sigma = float(np.sqrt(max(way @ frame.covariance_of(frame.edges[edge]) @ way, 0.0)))
    posterior = with_decimals(float(frame.posterior[edge]), 3)
    tracks = ", ".join(map(str, frame.tracks_of(edge).tolist()))
    return (
        f"edge {edge}: length {with_sigma(length, sigma)} mm, posterior {posterior}, "
        f"{frame.views[edge]} views, tracks {tracks}"
    )


def _vertex_words(frame: Wireframe, vertex: int) -> str:
    sigma = np.sqrt(np.diagonal(frame.covariance_of([vertex])))
    place = ", ".join(
        f"{axis} {with_sigma(float(value), float(error))}"
        for axis, value, error in zip("XYZ", frame.vertices_mm[vertex], sigma, strict=True)
    )
    kind = "corner" if frame.corner[vertex] else "free end"
    return f"{kind} {vertex} of {len(frame.edges_at(vertex))} edges: {place} mm"
