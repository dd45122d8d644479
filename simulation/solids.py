"""Opaque solids for scenes of blocks: polyhedra and cylinders, in millimetres.

A solid has flat faces, which hide what is behind them, and edges, which a picture may show.
A cylinder's faces are facets; its rims are edges in short chords, while its silhouette moves
with the viewpoint and is no edge.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

EDGE, RIM = "edge", "rim"


class Polyhedron(eqx.Module):
    """A solid with flat faces.

    Fields
    ------
    kind : "box", "wedge" or "l_block".
    vertices_mm : (n, 3)
    faces : indices of each face's vertices, counter-clockwise from outside; the first vertex
        sees the whole face, so that triangles fan out from it.
    """

    kind: str = eqx.field(static=True)
    vertices_mm: Float[np.ndarray, "n 3"]
    faces: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    @property
    def face_triangles_mm(self) -> tuple[Float[np.ndarray, "_ 3 3"], ...]:
        """The triangles of each face."""
        return tuple(
            np.stack(
                [self.vertices_mm[[face[0], face[i], face[i + 1]]] for i in range(1, len(face) - 1)]
            )
            for face in self.faces
        )

    @property
    def triangles_mm(self) -> Float[np.ndarray, "k 3 3"]:
        """The triangles of all faces."""
        return np.concatenate(self.face_triangles_mm)

    @property
    def edges_mm(self) -> Float[np.ndarray, "e 2 3"]:
        """Each edge once."""
        sides = {
            tuple(sorted((face[i - 1], face[i]))) for face in self.faces for i in range(len(face))
        }
        return self.vertices_mm[np.array(sorted(sides))]

    @property
    def edge_kinds(self) -> tuple[str, ...]:
        """Kind of each edge: always "edge"."""
        return (EDGE,) * len(self.edges_mm)

    def silhouette_mm(self, centre_world_mm: Float[np.ndarray, "3"]) -> Float[np.ndarray, "s 2 3"]:
        """Silhouette lines that depend on the viewpoint: none."""
        return np.zeros((0, 2, 3))

    def place(self, *, turn_deg: float, shift_mm: Float[np.ndarray, "3"]) -> "Polyhedron":
        """The solid turned about the vertical through the origin, then moved."""
        vertices = self.vertices_mm @ _turn(turn_deg).T + shift_mm
        return Polyhedron(self.kind, vertices, self.faces)


class Cylinder(eqx.Module):
    """An upright cylinder with `sides` facets as its mantle and chords as its rims."""

    base_centre_mm: Float[np.ndarray, "3"]
    radius_mm: float
    height_mm: float
    sides: int = eqx.field(static=True, default=96)
    kind: str = eqx.field(static=True, default="cylinder")

    @property
    def triangles_mm(self) -> Float[np.ndarray, "k 3 3"]:
        """The triangles of base, top and facets."""
        base, top = self._rims
        next_base, next_top = np.roll(base, -1, axis=0), np.roll(top, -1, axis=0)
        hub = np.broadcast_to(self.base_centre_mm, base.shape)
        above = hub + np.array([0.0, 0.0, self.height_mm])
        return np.concatenate(
            [
                np.stack([hub, next_base, base], axis=1),
                np.stack([above, top, next_top], axis=1),
                np.stack([base, next_base, next_top], axis=1),
                np.stack([base, next_top, top], axis=1),
            ]
        )

    @property
    def edges_mm(self) -> Float[np.ndarray, "e 2 3"]:
        """The chords of the lower rim, then of the upper one."""
        return np.concatenate(
            [np.stack([rim, np.roll(rim, -1, axis=0)], axis=1) for rim in self._rims]
        )

    @property
    def edge_kinds(self) -> tuple[str, ...]:
        """Kind of each edge: always "rim"."""
        return (RIM,) * (2 * self.sides)

    def silhouette_mm(self, centre_world_mm: Float[np.ndarray, "3"]) -> Float[np.ndarray, "s 2 3"]:
        """The two lines of the mantle at which rays from a viewpoint outside are tangent."""
        offset = centre_world_mm[:2] - self.base_centre_mm[:2]
        distance = float(np.hypot(*offset))
        if distance <= self.radius_mm:
            return np.zeros((0, 2, 3))
        angle = np.arctan2(offset[1], offset[0])
        half = np.arccos(self.radius_mm / distance)
        lines = []
        for theta in (angle - half, angle + half):
            around = self.radius_mm * np.array([np.cos(theta), np.sin(theta), 0.0])
            foot = self.base_centre_mm + around
            lines.append(np.stack([foot, foot + np.array([0.0, 0.0, self.height_mm])]))
        return np.stack(lines)

    def place(self, *, turn_deg: float, shift_mm: Float[np.ndarray, "3"]) -> "Cylinder":
        """The cylinder with its base turned about the vertical through the origin, then moved."""
        base = _turn(turn_deg) @ self.base_centre_mm + shift_mm
        return Cylinder(base, self.radius_mm, self.height_mm, self.sides)

    @property
    def _rims(self) -> tuple[np.ndarray, np.ndarray]:
        angle = np.arange(self.sides) * (2 * np.pi / self.sides)
        circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(self.sides)], axis=1)
        base = self.base_centre_mm + self.radius_mm * circle
        return base, base + np.array([0.0, 0.0, self.height_mm])


Solid = Polyhedron | Cylinder


def box(size_mm: tuple[float, float, float]) -> Polyhedron:
    """A box that stands on Z = 0, centred on the Z axis."""
    x, y, z = size_mm
    return _prism("box", np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2, z)


def wedge(size_mm: tuple[float, float, float]) -> Polyhedron:
    """A box of this size cut from its upper right edge to its lower left one (in X): a ramp."""
    x, y, z = size_mm
    profile = np.array([(-x / 2, 0.0), (x / 2, 0.0), (x / 2, z)])
    return _upright("wedge", profile, y)


def l_block(
    size_mm: tuple[float, float, float], thickness_mm: float, *, standing: bool
) -> Polyhedron:
    """An L of even thickness: lying, so that it is an L from above, or standing on one arm."""
    x, y, z = size_mm
    across = z if standing else y
    profile = np.array(
        [
            (thickness_mm, thickness_mm),
            (thickness_mm, across),
            (0.0, across),
            (0.0, 0.0),
            (x, 0.0),
            (x, thickness_mm),
        ]
    )
    if standing:
        return _upright("l_block", profile - np.array([x / 2, 0.0]), y)
    return _prism("l_block", profile - np.array([x, y]) / 2, z)


def _prism(kind: str, profile: Float[np.ndarray, "k 2"], height: float) -> Polyhedron:
    """A counter-clockwise profile in X and Y, raised from Z = 0 to a height."""
    count = len(profile)
    base = np.column_stack([profile, np.zeros(count)])
    vertices = np.concatenate([base, base + np.array([0.0, 0.0, height])])
    ring = tuple(range(count))
    # Backwards from the same first vertex, so that the base too fans out from it.
    faces = [(0, *reversed(ring[1:])), tuple(i + count for i in ring)]
    faces += [(i, (i + 1) % count, (i + 1) % count + count, i + count) for i in ring]
    return Polyhedron(kind, vertices, tuple(faces))


def _upright(kind: str, profile: Float[np.ndarray, "k 2"], depth: float) -> Polyhedron:
    """A counter-clockwise profile in X and Z, drawn out along Y, centred on it."""
    prism = _prism(kind, profile, depth)
    x, z, along = prism.vertices_mm.T
    return Polyhedron(kind, np.stack([x, depth / 2 - along, z], axis=1), prism.faces)


def _turn(turn_deg: float) -> Float[np.ndarray, "3 3"]:
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
