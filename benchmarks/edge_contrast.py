"""Which parts of a scene's edges a noise-free picture shows, and by how many grey levels."""

import cv2
import numpy as np

from simulation.scenes import Scene
from trinoc.geometry.camera import Camera
from trinoc.synth.truth import SeenParts

# Across an edge the grey levels are taken this far to both sides, in pixels of the picture.
SIDE_PX = 1.0
SHOWN_STEP = 8.0


def seen_parts(scene: Scene, camera: Camera, grey: np.ndarray, *, fold: int) -> SeenParts:
    """Parts of the edges, cut where the step across them passes 8 grey levels.

    `grey` is the picture before blur and noise, fold x fold of its pixels in one of the
    camera's. Samples are a pixel apart or less; a part's step is the median of its samples.
    """
    visible = scene.seen_by(camera)
    rows = []
    for edge, (start, end) in zip(visible.segment, visible.extent, strict=True):
        first, second = scene.edges_mm[edge]
        ends = project_all(camera, np.stack([first, second]))
        length = np.hypot(*(ends[1] - ends[0])) * (end - start)
        count = max(2, int(np.ceil(length)))
        borders = np.linspace(start, end, count + 1)
        middle = (borders[:-1] + borders[1:]) / 2
        uv = project_all(camera, first + middle[:, None] * (second - first))
        along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        # v points down: on the picture, left of the direction (du, dv) is (dv, -du).
        left = SIDE_PX * np.array([along[1], -along[0]])
        step = _sample(grey, uv + left, fold) - _sample(grey, uv - left, fold)
        shown = np.abs(step) >= SHOWN_STEP
        cuts = np.flatnonzero(np.diff(shown)) + 1
        for low, high in zip([0, *cuts], [*cuts, count], strict=True):
            rows.append((edge, borders[low], borders[high], float(np.median(step[low:high]))))
    table = np.array(rows).reshape(-1, 4)
    return SeenParts(table[:, 0].astype(np.int64), table[:, 1:3].copy(), table[:, 3].copy())


def project_all(camera: Camera, points_mm: np.ndarray) -> np.ndarray:
    """(n, 2) pixels of points in space, for a lens without distortion."""
    image = points_mm @ camera.matrix_px[:, :3].T + camera.matrix_px[:, 3]
    return image[:, :2] / image[:, 2:]


def _sample(grey: np.ndarray, uv_px: np.ndarray, fold: int) -> np.ndarray:
    folded = ((uv_px + 0.5) * fold - 0.5).astype(np.float32)
    return cv2.remap(
        grey.astype(np.float32), folded[None], None, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )[0].astype(np.float64)  # fmt: skip
