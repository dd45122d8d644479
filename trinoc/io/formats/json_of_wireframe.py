"""A wire frame as JSON: vertices, edges and faces, each with its own covariance."""

import json
from pathlib import Path

import numpy as np

from trinoc.io.atomic import write_text
from trinoc.io.formats.format import Format
from trinoc.match.wire_frame.frame import Wireframe


def write_json(frame: Wireframe, path: Path, unit_mm: float) -> None:
    """Write vertices, edges and faces of a wire frame, and line ends that do not fit, as JSON.

    Lengths are in units of `unit_mm`.
    """
    area = unit_mm**2
    vertex_covariance, edge_covariance = frame.vertices_covariance_mm2, frame.covariance_mm2
    # Of a plane, the offset alone is a length.
    scale = np.array([1.0, 1.0, 1.0, 1 / unit_mm])
    document = {
        "format": "trinoc-wireframe",
        "version": 1,
        "unit_mm": unit_mm,
        "vertices": [
            {
                "place": (position_mm / unit_mm).tolist(),
                "covariance": (vertex_covariance[vertex] / area).tolist(),
                "corner": bool(frame.corner[vertex]),
            }
            for vertex, position_mm in enumerate(frame.vertices_mm)
        ],
        "edges": [
            {
                "vertices": pair,
                "covariance": (edge_covariance[edge] / area).tolist(),
                "posterior": float(frame.posterior[edge]),
                "views": int(frame.views[edge]),
                "viewpoint_dependent": bool(frame.viewpoint_dependent[edge]),
                "tracks": frame.tracks_of(edge).tolist(),
            }
            for edge, pair in enumerate(frame.edges.tolist())
        ],
        "faces": [
            {
                "vertices": loop.tolist(),
                "normal": plane[:3].tolist(),
                "offset": float(plane[3] / unit_mm),
                "covariance": (frame.planes_covariance[face] * np.outer(scale, scale)).tolist(),
                "posterior": float(posterior),
                "facing": bool(frame.facing[face]),
            }
            for face, (loop, plane, posterior) in enumerate(
                zip(frame.faces, frame.planes, frame.face_posterior, strict=True)
            )
        ],
        "let_go": [
            {"track": track, "place": position_mm, "reason": reason}
            for track, position_mm, reason in zip(
                frame.let_go.track.tolist(),
                (frame.let_go.place_mm / unit_mm).tolist(),
                frame.let_go.reason.tolist(),
                strict=True,
            )
        ],
    }
    write_text(path, json.dumps(document, indent=1) + "\n")


wireframe_json = Format(
    name="json",
    title="JSON",
    holds=("wireframe",),
    endings=(".json",),
    frames="the world of the rig, Z up",
    write=write_json,
)
