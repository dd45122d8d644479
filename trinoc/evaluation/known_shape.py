"""A shape whose edges are known: what lines in space are compared with."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.numerics.buckets import blocks
from trinoc.numerics.values import Value
from trinoc.synth.truth import SceneTruth, parts_in_views_mm, points_along, shown_parts_mm
from trinoc.synth.visibility import visible_parts

# Grey levels that differ by less across an edge do not show it.
GREY_STEP = 8.0
EVERY_EDGE = "every edge"
# Triangles times edges whose hiding is computed at once, which bounds the memory.
_AT_ONCE = 1_000_000


class KnownShape(Value):
    """Edges in space, and which parts of them ought to be found.

    Fields
    ------
    edges_mm : (m, 2, 3) ends of every edge. What lies on one of them is right.
    wanted_edge : (k,) edge of each part that ought to be found.
    wanted_extent : (k, 2) from where to where along it, 0 at its first end and 1 at its second.
    triangles_mm : (f, 3, 3) faces that hide what is behind them; none where not known.
    wanted : in words, what ought to be found.
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
        """A shape of which every edge ought to be found."""
        count = len(edges_mm)
        faces = np.zeros((0, 3, 3)) if triangles_mm is None else triangles_mm
        whole = np.tile([0.0, 1.0], (count, 1))
        return cls(edges_mm, np.arange(count), whole, faces, EVERY_EDGE)

    @classmethod
    def of_scene(cls, truth: SceneTruth, *, grey_step: float = GREY_STEP) -> "KnownShape":
        """A made scene, of which the straight parts ought to be found that two pictures show.

        Grey levels differ by `grey_step` or more across them; what lies on another edge, a chord
        of a rim too, is right all the same.
        """
        labelled = SceneTruth(_labels(len(truth.edges_mm)), truth.edge_kinds, truth.seen)
        parts = shown_parts_mm(labelled, views=2, grey_step=grey_step, kinds=("edge",))
        wanted = f"straight edges that two pictures show by {grey_step:g} grey levels or more"
        return cls(truth.edges_mm, *_read_labels(parts), np.zeros((0, 3, 3)), wanted)

    def seen_by(self, rig: Rig) -> "KnownShape":
        """The same edges, of which those parts are wanted that two cameras have before them.

        Where faces are known they hide what is behind them; the frames of the pictures always
        cut.
        """
        parts = {name: self._before(camera) for name, camera in rig.items()}
        labels = _labels(len(self.edges_mm))
        found = parts_in_views_mm(labels, parts, views=min(2, len(rig)))
        hidden = "" if len(self.triangles_mm) else ", faces not known"
        wanted = f"edges that two cameras have before them{hidden}"
        return type(self)(self.edges_mm, *_read_labels(found), self.triangles_mm, wanted)

    def _before(self, camera: Camera) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 2"]]:
        """What a camera sees: edge, and from where to where along it."""
        edges, extents = [], []
        step = max(1, _AT_ONCE // max(1, len(self.triangles_mm)))
        for part in blocks(len(self.edges_mm), step):
            seen = visible_parts(camera, self.edges_mm[part], self.triangles_mm)
            edges.append(part.start + seen.segment)
            extents.append(seen.extent)
        return np.concatenate(edges), np.concatenate(extents)

    @property
    def wants_every_edge(self) -> bool:
        """Whether nothing is known of what pictures show."""
        return self.wanted == EVERY_EDGE

    @property
    def wanted_mm(self) -> Float[np.ndarray, "k 2 3"]:
        """Ends in space of the parts that ought to be found."""
        return points_along(self.edges_mm[self.wanted_edge], self.wanted_extent)


def _labels(count: int) -> Float[np.ndarray, "m 2 3"]:
    """Stand-ins for edges: a point of one says which edge it is on, and where along it."""
    labels = np.zeros((count, 2, 3))
    labels[:, :, 0] = np.arange(count)[:, None]
    labels[:, 1, 1] = 1.0
    return labels


def _read_labels(
    parts: Float[np.ndarray, "k 2 3"],
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 2"]]:
    return np.rint(parts[:, 0, 0]).astype(np.int64), parts[:, :, 1].copy()
