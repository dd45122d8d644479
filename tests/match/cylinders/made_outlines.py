"""Outlines of cylinders anywhere, by the geometry of the upright one of `simulation`."""

import numpy as np

from simulation.solids import Cylinder
from trinoc.geometry.rig import Rig
from trinoc.geometry.rotation import rotation_from_vector
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches

SIGMA_PX = 0.2


class Placed:
    """A cylinder of `simulation`, turned about the origin by a rotation vector and moved."""

    def __init__(self, radius_mm, height_mm, turn=(0.0, 0.0, 0.0), shift_mm=(0.0, 0.0, 0.0)):
        self.solid = Cylinder(np.zeros(3), radius_mm, height_mm)
        self.turn = np.asarray(rotation_from_vector(np.array(turn)))
        self.shift_mm = np.array(shift_mm)

    @property
    def axis_mm(self) -> np.ndarray:
        """Both ends."""
        ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, self.solid.height_mm]])
        return ends @ self.turn.T + self.shift_mm

    def outlines_mm(self, centre_mm: np.ndarray) -> np.ndarray:
        """The two lines that a camera there takes for edges."""
        lines = self.solid.silhouette_mm(self.turn.T @ (centre_mm - self.shift_mm))
        return lines @ self.turn.T + self.shift_mm


def seen_by(rig: Rig, cylinders, lines_mm=None, *, sigma_px=0.0, seed=0) -> dict[str, Segments]:
    """Segments of every view: the outlines of each cylinder in turn, then lines."""
    rng = np.random.default_rng(seed)
    lines_mm = np.zeros((0, 2, 3)) if lines_mm is None else lines_mm
    found = {}
    for name, camera in rig.items():
        outlines = [each.outlines_mm(np.asarray(camera.centre_world_mm)) for each in cylinders]
        every = np.concatenate([*outlines, lines_mm])
        image = every @ camera.matrix_px[:, :3].T + camera.matrix_px[:, 3]
        ends = image[..., :2] / image[..., 2:]
        ends = ends + sigma_px * rng.normal(size=ends.shape)
        found[name] = Segments.from_endpoints(ends, sigma_px=SIGMA_PX)
    return found


def nothing_matched(segments: dict[str, Segments]) -> Matches:
    """Matches without a track."""
    views = len(segments)
    return Matches(
        views=tuple(segments),
        index=np.zeros((0, views), dtype=np.int64),
        fragments_px=np.zeros((0, views, 2, 2)),
        lines_mm=np.zeros((0, 2, 3)),
        covariance_mm2=np.zeros((0, 6, 6)),
        stage=np.zeros(0, dtype="<U11"),
        posterior=np.zeros(0),
        rival_posterior=np.zeros(0),
        reasons={name: np.full(len(own), "?") for name, own in segments.items()},
        counts={},
    )
