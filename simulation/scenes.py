"""Scenes with known edges: blocks on a table, see-through boxes, loose segments."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from simulation.solids import EDGE, Cylinder, Solid, box, l_block, wedge
from trinoc.geometry.camera import Camera
from trinoc.synth.truth import points_along
from trinoc.synth.visibility import VisibleParts, visible_parts


class Scene(eqx.Module):
    """Edges in space, and the solids that hide them.

    Fields
    ------
    edges_mm : (m, 2, 3) ends of every edge.
    edge_kinds : "edge", or "rim" for the chords of a cylinder's rims.
    edge_solid : (m,) the solid each edge belongs to.
    solids : the opaque solids; empty for a scene in which nothing hides anything.
    """

    edges_mm: Float[np.ndarray, "m 2 3"]
    edge_kinds: tuple[str, ...] = eqx.field(static=True)
    edge_solid: Int[np.ndarray, "m"]
    solids: tuple[Solid, ...]

    @classmethod
    def of_solids(cls, solids: tuple[Solid, ...]) -> "Scene":
        """The scene of opaque solids."""
        edges = [solid.edges_mm for solid in solids]
        return cls(
            np.concatenate(edges),
            tuple(kind for solid in solids for kind in solid.edge_kinds),
            np.repeat(np.arange(len(solids)), [len(part) for part in edges]),
            solids,
        )

    @classmethod
    def of_edges(cls, edges_mm: Float[np.ndarray, "m 2 3"]) -> "Scene":
        """A scene of edges alone, visible from everywhere."""
        count = len(edges_mm)
        return cls(edges_mm, (EDGE,) * count, np.arange(count), ())

    @property
    def triangles_mm(self) -> Float[np.ndarray, "k 3 3"]:
        """The faces of all solids, which hide what is behind them."""
        if not self.solids:
            return np.zeros((0, 3, 3))
        return np.concatenate([solid.triangles_mm for solid in self.solids])

    def seen_by(self, camera: Camera) -> VisibleParts:
        """The parts of the edges that a camera sees."""
        return visible_parts(camera, self.edges_mm, self.triangles_mm)

    def silhouettes_seen_by(self, camera: Camera) -> Float[np.ndarray, "s 2 3"]:
        """Visible parts of the solids' silhouettes for this camera, as ends in space."""
        lines = [solid.silhouette_mm(camera.centre_world_mm) for solid in self.solids]
        if not lines:
            return np.zeros((0, 2, 3))
        stacked = np.concatenate(lines)
        parts = visible_parts(camera, stacked, self.triangles_mm)
        return points_along(stacked[parts.segment], parts.extent)


def demo_scene(*, cylinder_sides: int = 96) -> Scene:
    """Three boxes, a wedge, an L-shaped block and a cylinder on a table, all within 170 mm."""

    def point(x: float, y: float, z: float = 0.0) -> Float[np.ndarray, "3"]:
        return np.array([x, y, z])

    return Scene.of_solids(
        (
            box((52.0, 36.0, 30.0)).place(turn_deg=24.0, shift_mm=point(-42.0, 22.0)),
            box((24.0, 20.0, 18.0)).place(turn_deg=52.0, shift_mm=point(-43.0, 23.0, 30.0)),
            box((22.0, 46.0, 22.0)).place(turn_deg=-33.0, shift_mm=point(62.0, -28.0)),
            wedge((48.0, 30.0, 26.0)).place(turn_deg=-17.0, shift_mm=point(24.0, 42.0)),
            l_block((52.0, 44.0, 20.0), 18.0, standing=False).place(
                turn_deg=12.0, shift_mm=point(2.0, -30.0)
            ),
            Cylinder(point(-58.0, -36.0), 15.0, 32.0, cylinder_sides),
        )
    )


def block_scene(
    seed: int, *, count: int = 6, reach_mm: float = 72.0, cylinder_sides: int = 96
) -> Scene:
    """Solids drawn by `seed`, apart from each other on a table, some with a box on top.

    The first four are a box, a wedge, an L-shaped block and a cylinder, as far as `count`
    goes. They stand within `reach_mm` of the origin; solids for which no room is found after
    many tries are left out.
    """
    generator = np.random.default_rng(seed)
    solids: list[Solid] = []
    taken: list[tuple[Float[np.ndarray, "2"], float]] = []
    for index in range(count):
        kind = index if index < 4 else int(generator.integers(4))
        solid, radius, top = _random_solid(kind, generator, cylinder_sides)
        position_mm = _free_place(generator, taken, radius, reach_mm)
        if position_mm is None:
            continue
        taken.append((position_mm, radius))
        turn = float(generator.uniform(0.0, 360.0))
        solids.append(solid.place(turn_deg=turn, shift_mm=np.append(position_mm, 0.0)))
        if top is not None and generator.random() < 0.4:
            size = generator.uniform(0.5, 0.8, 3) * min(top[:2])
            upper = box((float(size[0]), float(size[1]), float(size[2])))
            turn += float(generator.uniform(20.0, 70.0))
            solids.append(upper.place(turn_deg=turn, shift_mm=np.append(position_mm, top[2])))
    return Scene.of_solids(tuple(solids))


def see_through_boxes(seed: int, *, count: int, reach_mm: float = 80.0) -> Scene:
    """Boxes whose every edge is visible: junctions and parallels without hidden lines."""
    generator = np.random.default_rng(seed)
    edges = []
    for _ in range(count):
        size = generator.uniform(8.0, 45.0, 3)
        shift = np.append(generator.uniform(-reach_mm, reach_mm, 2), generator.uniform(0.0, 40.0))
        turn = float(generator.uniform(0.0, 90.0))
        solid = box((float(size[0]), float(size[1]), float(size[2])))
        edges.append(solid.place(turn_deg=turn, shift_mm=shift).edges_mm)
    return Scene.of_edges(np.concatenate(edges))


def loose_segments(seed: int, *, count: int, reach_mm: float = 80.0) -> Scene:
    """Segments of 8 to 60 mm in all directions, from the table to 60 mm above it."""
    generator = np.random.default_rng(seed)
    middle = np.column_stack(
        [generator.uniform(-reach_mm, reach_mm, (count, 2)), generator.uniform(0.0, 60.0, count)]
    )
    direction = generator.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    half = generator.uniform(4.0, 30.0, (count, 1)) * direction
    return Scene.of_edges(np.stack([middle - half, middle + half], axis=1))


def _random_solid(
    kind: int, generator: np.random.Generator, cylinder_sides: int
) -> tuple[Solid, float, tuple[float, float, float] | None]:
    """A solid on the Z axis, its footprint's radius, and the size of its top for a box."""
    x, y, z = (float(value) for value in generator.uniform((28, 22, 14), (56, 44, 40)))
    radius = float(np.hypot(x, y)) / 2
    if kind == 0:
        return box((x, y, z)), radius, (x, y, z)
    if kind == 1:
        return wedge((x, y, z)), radius, None
    if kind == 2:
        thickness = float(generator.uniform(0.3, 0.45)) * min(x, y)
        if generator.random() < 0.5:
            return l_block((x, y, z), thickness, standing=False), radius, None
        return l_block((x, y, max(z, 24.0)), min(thickness, 11.0), standing=True), radius, None
    half = y / 2
    return Cylinder(np.zeros(3), half, z, cylinder_sides), half, (1.2 * half, 1.2 * half, z)


def _free_place(
    generator: np.random.Generator,
    taken: list[tuple[Float[np.ndarray, "2"], float]],
    radius_mm: float,
    reach_mm: float,
) -> Float[np.ndarray, "2"] | None:
    """A position within reach, 3 mm clear of all other footprints; None if none is found."""
    for _ in range(500):
        position_mm = generator.uniform(-reach_mm, reach_mm, 2)
        clear = all(np.hypot(*(position_mm - p)) > radius_mm + r + 3.0 for p, r in taken)
        if clear and np.hypot(*position_mm) < reach_mm:
            return position_mm
    return None
