"""Simulated 2-D segments of a scene, as a detector reports them, with their true edges.

End points are noisy, segments break in pieces, some are missing in one view, some are
nobody's, and detectors cut ends back: each by its own number, so that a matcher can be tried
against one trouble at a time.
"""

import itertools

import equinox as eqx
import numpy as np
from jaxtyping import Float

from simulation.scenes import Scene
from trinoc.geometry.camera import Camera
from trinoc.geometry.projection import project_by_matrix
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.synth.truth import NOT_SCORED, SPURIOUS, SegmentTruth, points_along


class Detector(eqx.Module):
    """Errors of a segment detector.

    Fields
    ------
    end_sigma_px : noise of both coordinates of each end point.
    broken_share : segments that come in two or three pieces.
    spurious_share : segments that are nobody's, relative to those that are somebody's.
    missing_share : edges that one view, drawn at random, does not show.
    cut_back_px : each end is cut back by up to this.
    shortest_px : shorter segments are not found.
    """

    end_sigma_px: float = 0.5
    broken_share: float = 0.2
    spurious_share: float = 0.2
    missing_share: float = 0.15
    cut_back_px: float = 0.0
    shortest_px: float = 8.0


PERFECT = Detector(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def simulate_segments(
    scene: Scene, rig: Rig, detector: Detector, *, seed: int
) -> tuple[dict[str, Segments], SegmentTruth]:
    """Segments of every view in random order and direction, and their truth.

    Outlines of cylinders, which are no edges, come as segments that are not scored. Lens
    distortion is left out: the segments are those of the undistorted pictures.
    """
    generator = np.random.default_rng(seed)
    views = len(rig)
    missing = generator.random(len(scene.edges_mm)) < detector.missing_share
    blind_view = np.where(missing, generator.integers(views, size=len(missing)), views)
    segments, edge_of, extent = {}, {}, {}
    for number, (name, camera) in enumerate(rig.items()):
        parts = scene.seen_by(camera)
        shown = blind_view[parts.segment] != number
        owner, part = _break_edges(parts.segment[shown], parts.extent[shown], detector, generator)
        ends_mm = points_along(scene.edges_mm[owner], part)
        outlines = scene.silhouettes_seen_by(camera)
        owner = np.concatenate([owner, np.full(len(outlines), NOT_SCORED)])
        part = np.concatenate([part, np.tile([0.0, 1.0], (len(outlines), 1))])
        ends = _images(camera, np.concatenate([ends_mm, outlines]))
        ends, part = _cut_back(ends, part, detector, generator)
        is_long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) >= max(detector.shortest_px, 1e-9)
        ends, part, owner = ends[is_long], part[is_long], owner[is_long]
        stray = _strays(camera, round(detector.spurious_share * len(ends)), generator)
        ends = np.concatenate([ends, stray])
        ends = ends + detector.end_sigma_px * generator.normal(size=ends.shape)
        owner = np.concatenate([owner, np.full(len(stray), SPURIOUS)])
        part = np.concatenate([part, np.zeros((len(stray), 2))])
        turned = generator.random(len(ends)) < 0.5
        ends = np.where(turned[:, None, None], ends[:, ::-1], ends)
        order = generator.permutation(len(ends))
        segments[name] = Segments.from_endpoints(
            ends[order],
            sigma_px=max(detector.end_sigma_px, 0.05),
            image_size_px=camera.image_size_px,
        )
        edge_of[name], extent[name] = owner[order], part[order]
    return segments, SegmentTruth(scene.edges_mm, edge_of, extent)


def _break_edges(
    owner: np.ndarray, extent: np.ndarray, detector: Detector, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Parts of edges, some of them replaced by their two or three pieces with gaps between."""
    pieces: list[tuple[int, float, float]] = []
    for edge, (start, end) in zip(owner, extent, strict=True):
        count = 1
        if generator.random() < detector.broken_share:
            count = int(generator.integers(2, 4))
        cuts = np.sort(generator.uniform(0.2, 0.8, count - 1))
        borders = np.concatenate([[0.0], cuts, [1.0]])
        gap = 0.01 if count > 1 else 0.0
        for low, high in itertools.pairwise(borders):
            low, high = low + gap * (low > 0), high - gap * (high < 1)
            if high > low:
                pieces.append(
                    (int(edge), start + low * (end - start), start + high * (end - start))
                )
    table = np.array(pieces).reshape(-1, 3)
    return table[:, 0].astype(np.int64), table[:, 1:].copy()


def _cut_back(
    ends_px: np.ndarray, extent: np.ndarray, detector: Detector, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Segments without up to `cut_back_px` at each end; extents follow, to first order."""
    length = np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=1, keepdims=True)
    share = generator.uniform(0.0, detector.cut_back_px, (len(ends_px), 2))
    share = np.minimum(share / np.maximum(length, 1e-9), 0.45)
    inward = np.stack([share[:, 0], 1 - share[:, 1]], axis=1)
    cut = ends_px[:, :1] + inward[..., None] * (ends_px[:, 1:] - ends_px[:, :1])
    return cut, extent[:, :1] + inward * (extent[:, 1:] - extent[:, :1])


def _strays(camera: Camera, count: int, generator: np.random.Generator) -> np.ndarray:
    """Segments of 10 to 80 px at random positions, with ends clipped to the picture."""
    size = np.array(camera.image_size_px, dtype=np.float64)
    middle = generator.uniform(0.0, 1.0, (count, 2)) * size
    angle = generator.uniform(0.0, np.pi, count)
    half = generator.uniform(5.0, 40.0, (count, 1)) * np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.clip(np.stack([middle - half, middle + half], axis=1), -0.5, size - 0.5)


def _images(camera: Camera, points_mm: Float[np.ndarray, "n 2 3"]) -> Float[np.ndarray, "n 2 2"]:
    return project_by_matrix(camera.matrix_px, points_mm)
