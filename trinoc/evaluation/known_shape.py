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
    """Edges in space, and the parts of them that should be detected.

    Attributes
    ----------
    edges_mm : (m, 2, 3)
        Ends of every edge. A line on any of them is right.
    wanted_edge : (k,)
        Edge of each part that should be detected.
    wanted_extent : (k, 2)
        Start and stop of the part along the edge: 0 at its first end, 1 at its second.
    triangles_mm : (f, 3, 3)
        Faces that hide edges behind them; empty if unknown.
    wanted : str
        Description of the wanted parts.
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
        """Shape whose edges should all be detected."""
        count = len(edges_mm)
        faces = np.zeros((0, 3, 3)) if triangles_mm is None else triangles_mm
        full_extent = np.tile([0.0, 1.0], (count, 1))
        return cls(edges_mm, np.arange(count), full_extent, faces, EVERY_EDGE)

    @classmethod
    def of_scene(cls, truth: SceneTruth, *, grey_step: float = GREY_STEP) -> "KnownShape":
        """Shape of a synthetic scene: straight edges visible in two images should be detected.

        Visible means a difference of at least `grey_step` grey levels across the edge. Lines on
        other edges, such as chords of a rim, are also right.
        """
        labelled = SceneTruth(_labels(len(truth.edges_mm)), truth.edge_kinds, truth.seen)
        parts = shown_parts_mm(labelled, views=2, grey_step=grey_step, kinds=("edge",))
        wanted = f"straight edges that two pictures show by {grey_step:g} grey levels or more"
        return cls(truth.edges_mm, *_read_labels(parts), np.zeros((0, 3, 3)), wanted)

    def visible_to(self, rig: Rig) -> "KnownShape":
        """The same shape, with the edges that count as visible: those that two cameras see.

        Known faces hide the edges behind them. Parts outside the images are not visible.
        """
        visible = {name: self._before(camera) for name, camera in rig.items()}
        labels = _labels(len(self.edges_mm))
        shared_parts = parts_in_views_mm(labels, visible, views=min(2, len(rig)))
        remark = "" if len(self.triangles_mm) else ", faces unknown"
        wanted = f"edges visible to two cameras{remark}"
        return type(self)(self.edges_mm, *_read_labels(shared_parts), self.triangles_mm, wanted)

    def _before(self, camera: Camera) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 2"]]:
        """(edge, start and stop along it) of the parts that are visible to a camera."""
        edges, extents = [], []
        step = max(1, _PAIRS_PER_BLOCK // max(1, len(self.triangles_mm)))
        for part in blocks(len(self.edges_mm), step):
            visible = visible_parts(camera, self.edges_mm[part], self.triangles_mm)
            edges.append(part.start + visible.segment)
            extents.append(visible.extent)
        return np.concatenate(edges), np.concatenate(extents)

    @property
    def wants_every_edge(self) -> bool:
        """True if the visibility in images is unknown."""
        return self.wanted == EVERY_EDGE

    @property
    def wanted_mm(self) -> Float[np.ndarray, "k 2 3"]:
        """Ends of the wanted parts, (k, 2, 3)."""
        return points_along(self.edges_mm[self.wanted_edge], self.wanted_extent)


def _labels(count: int) -> Float[np.ndarray, "m 2 3"]:
    """Pseudo-edges whose points have the edge's index as x and the position along it as y."""
    labels = np.zeros((count, 2, 3))
    labels[:, :, 0] = np.arange(count)[:, None]
    labels[:, 1, 1] = 1.0
    return labels


def _read_labels(
    parts: Float[np.ndarray, "k 2 3"],
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 2"]]:
    return np.rint(parts[:, 0, 0]).astype(np.int64), parts[:, :, 1].copy()
