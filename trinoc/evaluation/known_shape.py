"""Known shapes: edges that 3-D lines are compared with."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.numerics.buckets import blocks
from trinoc.numerics.values import Value
from trinoc.synth.truth import SceneTruth, parts_in_views_mm, points_along, shown_parts_mm
from trinoc.synth.visibility import visible_parts

# Smallest difference of grey levels across a visible edge.
GREY_STEP = 8.0
EVERY_EDGE = "every edge"
# Largest number of triangle-edge pairs per block, to bound memory.
_PAIRS_PER_BLOCK = 1_000_000


class KnownShape(Value):
    """Known edges in space, and the parts of them that should be detected.

    Attributes
    ----------
    edges_mm : (m, 2, 3)
        Ends of every edge. A detected line on any edge is right.
    wanted_edge : (k,)
        Index of the edge of each part that should be detected.
    wanted_extent : (k, 2)
        Start and end of the part along its edge: 0 at the edge's first end, 1 at its second end.
    triangles_mm : (f, 3, 3)
        Faces that hide edges behind them; empty if unknown.
    wanted : str
        Description of the parts that should be detected.
    """

    edges_mm: Float[np.ndarray, "m 2 3"]
    wanted_edge: Int[np.ndarray, "k"]
    wanted_extent: Float[np.ndarray, "k 2"]
    triangles_mm: Float[np.ndarray, "f 3 3"]
    wanted: str = eqx.field(static=True)

    @classmethod
    def of_edges(
        cls,
        edges_mm: Float[np.ndarray, "m 2 3"],
        triangles_mm: Float[np.ndarray, "f 3 3"] | None = None,
    ) -> "KnownShape":
        """Create a shape of which every edge should be detected."""
        count = len(edges_mm)
        faces = np.zeros((0, 3, 3)) if triangles_mm is None else triangles_mm
        full_extent = np.tile([0.0, 1.0], (count, 1))
        return cls(edges_mm, np.arange(count), full_extent, faces, EVERY_EDGE)

    @classmethod
    def of_scene(cls, truth: SceneTruth, *, grey_step: float = GREY_STEP) -> "KnownShape":
        """Create the shape of a synthetic scene.

        The parts of straight edges that are visible in two images should be detected. Visible means
        a difference of at least `grey_step` grey levels across the edge. Lines on other edges, such
        as straight pieces of a circular rim, also count as correct.
        """
        labelled = SceneTruth(_labels(len(truth.edges_mm)), truth.edge_kinds, truth.seen)
        parts = shown_parts_mm(labelled, views=2, grey_step=grey_step, kinds=("edge",))
        wanted = f"straight edges that two pictures show by {grey_step:g} grey levels or more"
        return cls(truth.edges_mm, *_read_labels(parts), np.zeros((0, 3, 3)), wanted)

    def visible_to(self, rig: Rig) -> "KnownShape":
        """Copy of this shape in which parts visible to two cameras of `rig` should be detected.

        Known faces hide the edges behind them. Parts outside the images are not visible.
        """
        visible = {name: self._parts_visible_to(camera) for name, camera in rig.items()}
        labels = _labels(len(self.edges_mm))
        shared_parts = parts_in_views_mm(labels, visible, views=min(2, len(rig)))
        remark = "" if len(self.triangles_mm) else ", faces unknown"
        wanted = f"edges visible to two cameras{remark}"
        return type(self)(self.edges_mm, *_read_labels(shared_parts), self.triangles_mm, wanted)

    def _parts_visible_to(
        self, camera: Camera
    ) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 2"]]:
        """Parts of edges visible to a camera: (edge index (k,), start and end along it (k, 2))."""
        edges, extents = [], []
        step = max(1, _PAIRS_PER_BLOCK // max(1, len(self.triangles_mm)))
        for rows in blocks(len(self.edges_mm), step):
            visible = visible_parts(camera, self.edges_mm[rows], self.triangles_mm)
            edges.append(rows.start + visible.segment)
            extents.append(visible.extent)
        return np.concatenate(edges), np.concatenate(extents)

    @property
    def wants_every_edge(self) -> bool:
        """True if every edge should be detected, because the visibility is unknown."""
        return self.wanted == EVERY_EDGE

    @property
    def wanted_mm(self) -> Float[np.ndarray, "k 2 3"]:
        """Ends of the parts that should be detected, (k, 2, 3)."""
        return points_along(self.edges_mm[self.wanted_edge], self.wanted_extent)


def _labels(count: int) -> Float[np.ndarray, "m 2 3"]:
    """Artificial edges that encode edge indices and positions as coordinates.

    Every point on edge i has x = i, and y is its position along the edge, 0 to 1.
    """
    labels = np.zeros((count, 2, 3))
    labels[:, :, 0] = np.arange(count)[:, None]
    labels[:, 1, 1] = 1.0
    return labels


def _read_labels(
    parts: Float[np.ndarray, "k 2 3"],
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 2"]]:
    return np.rint(parts[:, 0, 0]).astype(np.int64), parts[:, :, 1].copy()
