"""Simulated scenes from files: NAME.npz with cameras and segments, NAME.gt.npz with truth.

NAME.npz: P (3, 3, 4), size (w, h), segs_0 .. segs_2 (n, 4). NAME.gt.npz: X (m, 6) edges, gid_v
the edge of each segment (-1 nobody's, -2 not scored), gt_v its extent on it.
"""

from pathlib import Path

import numpy as np

from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.synth.truth import SegmentTruth

VIEWS = ("upper", "left", "right")


def load_scene(
    folder: Path, name: str, *, sigma_px: float = 0.5
) -> tuple[Rig, dict[str, Segments], SegmentTruth]:
    """The rig, the segments of each view, and their true edges."""
    scene, truth = np.load(folder / f"{name}.npz"), np.load(folder / f"{name}.gt.npz")
    width, height = (int(side) for side in scene["size"])
    rig = Rig.from_matrices(dict(zip(VIEWS, scene["P"], strict=True)), (width, height))
    segments, edge_of, extent = {}, {}, {}
    for number, view in enumerate(VIEWS):
        segments[view] = Segments.from_endpoints(
            scene[f"segs_{number}"], sigma_px=sigma_px, image_size_px=(width, height)
        )
        edge_of[view] = truth[f"gid_{number}"].astype(np.int64)
        extent[view] = truth[f"gt_{number}"].astype(np.float64)
    return rig, segments, SegmentTruth(truth["X"].reshape(-1, 2, 3), edge_of, extent)
