"""A wire frame as layers of lines: edges of three views and of two, faces, corners, free ends."""

import numpy as np

from trinoc.match import Wireframe
from trinoc.report.numbers import with_decimals, with_sigma
from trinoc.report.space_part import Layer

# Faces are drawn within their edges, so that both are seen.
INSET = 0.93


def wireframe_layers(frame: Wireframe) -> list[Layer]:
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
            layers.append(Layer(f"{said} ({len(chosen)})", role, parts, True, (), words))
    if len(frame.planes):
        parts = [_outline(points[loop]) for loop in frame.faces]
        layers.append(Layer(f"planar faces ({len(parts)})", "sheet", parts))
    for corner, said in ((True, "corners"), (False, "free ends")):
        chosen = np.flatnonzero(frame.corner == corner).tolist()
        if chosen:
            words = tuple(_vertex_words(frame, vertex) for vertex in chosen)
            parts = [points[vertex][None] for vertex in chosen]
            layers.append(Layer(f"{said} ({len(chosen)})", "ellipsoids", parts, corner, (), words))
    return layers


def _outline(corners_mm: np.ndarray) -> np.ndarray:
    centre = corners_mm.mean(axis=0)
    closed = np.concatenate([corners_mm, corners_mm[:1]])
    return centre + INSET * (closed - centre)


def edge_words(frame: Wireframe, edge: int) -> str:
    """What is known of an edge: its length, its posterior, the tracks that it is from."""
    first, second = frame.lines_mm[edge]
    length = float(np.linalg.norm(second - first))
    way = np.concatenate([first - second, second - first]) / max(length, np.finfo(float).tiny)
    sigma = float(np.sqrt(max(way @ frame.covariance_mm2[edge] @ way, 0.0)))
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
