"""Boxes on a table, their edges and the shadows that a lamp casts of them."""

import equinox as eqx
import numpy as np
from scipy.spatial import ConvexHull

from tests.match.made import pictures, rig_of
from trinoc.geometry.segments import Segments
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches

NEAR_LAMP = np.array([350.0, 240.0, 800.0, 1.0])
FAR_LAMP = np.array([-0.5, 0.35, 0.8, 0.0])
# Corner, sides and turn of each, mm and rad.
BOXES = (
    ((-55.0, -30.0), (34.0, 22.0, 30.0), 0.3),
    ((5.0, -40.0), (26.0, 30.0, 22.0), 0.9),
    ((-20.0, 25.0), (28.0, 18.0, 38.0), -0.4),
    ((35.0, 15.0), (20.0, 24.0, 16.0), 0.1),
)
TABLE, DARK, BODIES = 120.0, 42.0, (60.0, 170.0)


def edges_of(boxes=BOXES) -> np.ndarray:
    """(12 b, 2, 3) edges: 4 at the foot, 4 upright, 4 on top of each."""
    parts = []
    for corner, (width, depth, height), turn in boxes:
        cosine, sine = np.cos(turn), np.sin(turn)
        flat = np.array([[0, 0], [width, 0], [width, depth], [0, depth]])
        flat = flat @ np.array([[cosine, sine], [-sine, cosine]]) + corner
        low = np.column_stack([flat, np.zeros(4)])
        high = low + np.array([0.0, 0.0, height])
        parts.append(np.stack([low, np.roll(low, -1, axis=0)], axis=1))
        parts.append(np.stack([low, high], axis=1))
        parts.append(np.stack([high, np.roll(high, -1, axis=0)], axis=1))
    return np.concatenate(parts)


def shadows_of(boxes, lamp: np.ndarray) -> np.ndarray:
    """(n, 2, 3) boundaries on the table: what the hull of the cast corners adds to the foot."""
    found = []
    for box in boxes:
        edges = edges_of((box,))
        low, high = edges[:4, 0], edges[8:, 0]
        ray = high * lamp[3] - lamp[:3]
        cast = high - ray * (high[:, 2:] / ray[:, 2:])
        points = np.concatenate([low, cast])
        ring = ConvexHull(points[:, :2]).vertices
        for one, other in zip(ring, np.roll(ring, -1), strict=True):
            if one >= 4 or other >= 4:
                found.append(points[[one, other]])
    return np.array(found)


def scene_of(lamp: np.ndarray | None, sigma_px: float = 0.05, boxes=BOXES, seed: int = 0):
    """(rig, segments with levels, matches, which tracks are shadows) of a table with boxes."""
    rig = rig_of("upper", "left", "right")
    edges = edges_of(boxes)
    shadows = np.zeros((0, 2, 3)) if lamp is None else shadows_of(boxes, lamp)
    lines = np.concatenate([edges, shadows])
    generator = np.random.default_rng(seed)
    levels = np.concatenate(
        [generator.uniform(*BODIES, (len(edges), 2)), np.tile([TABLE, DARK], (len(shadows), 1))]
    )
    seen = pictures(rig, lines, sigma_px, seed)
    segments = {name: with_levels(ends, levels) for name, ends in seen.items()}
    matches = match_segments(segments, rig)
    return rig, segments, matches, is_shadow_of(matches, len(edges))


def with_levels(ends_px: np.ndarray, levels: np.ndarray) -> Segments:
    """Segments of a picture, and the grey levels beside them."""
    found = Segments.from_endpoints(np.asarray(ends_px), image_size_px=(512, 480))
    return eqx.tree_at(lambda s: s.side_levels, found, levels, is_leaf=lambda leaf: leaf is None)


def is_shadow_of(matches: Matches, edges: int) -> np.ndarray:
    """Whether each track holds shadows' segments alone, which come after those of edges."""
    held = np.where(matches.index >= 0, matches.index, edges)
    return np.all(held >= edges, axis=1)


def unit_toward(lamp: np.ndarray, middle_mm: np.ndarray) -> np.ndarray:
    """From the scene's middle to the lamp."""
    way = lamp[:3] - lamp[3] * middle_mm
    return way / np.linalg.norm(way)
