"""Cylinders as lines to turn, and what is known of each in words."""

from trinoc.geometry import Rig
from trinoc.match import Cylinders
from trinoc.report.numbers import with_decimals, with_sigma
from trinoc.report.space_content import Box, frusta
from trinoc.report.space_part import Label, Layer, SpaceFigure, View

# Room about the cylinders, as a share of their extent.
ROOM = 0.2


def cylinders_figure(cylinders: Cylinders, rig: Rig | None = None) -> SpaceFigure:
    """The cylinders, and the cameras of `rig`."""
    layers, labels = cylinders_layers(cylinders), []
    if rig is not None:
        layers.append(Layer("cameras", "cameras", frusta(rig)))
        labels = [Label(camera.centre_world_mm, name, "cameras") for name, camera in rig.items()]
    if len(cylinders) == 0:
        return SpaceFigure(tuple(layers), tuple(labels), ())
    around = cylinders.circles_mm().reshape(-1, 3)
    low, high = around.min(axis=0), around.max(axis=0)
    room = ROOM * float((high - low).max())
    return SpaceFigure(
        tuple(layers), tuple(labels), (View("Cylinders", Box(low - room, high + room)),)
    )


def cylinders_layers(cylinders: Cylinders) -> list[Layer]:
    """One layer of the wires of all of them, or none."""
    if not len(cylinders):
        return []
    rows, parts = zip(*cylinders.wires().lines(), strict=True)
    words = tuple(cylinder_words(cylinders, row) for row in rows)
    return [Layer(f"cylinders ({len(cylinders)})", "joined", list(parts), True, (), words)]


def cylinder_words(cylinders: Cylinders, row: int) -> str:
    """What is known of a cylinder: its radius, its posterior, its outlines."""
    outlines = "; ".join(
        f"{name} {', '.join(map(str, found.tolist()))}"
        for name, found in cylinders.outlines_of(row).items()
        if len(found)
    )
    return (
        f"cylinder {row}: radius {_radius(cylinders, row)} mm, posterior "
        f"{with_decimals(float(cylinders.posterior[row]), 3)}, outlines {outlines}"
    )


def with_cylinders(figure: SpaceFigure, cylinders: Cylinders) -> SpaceFigure:
    """A figure of the segments, and the cylinders in it."""
    return figure._replace(layers=(*figure.layers, *cylinders_layers(cylinders)))


TABLE_HEAD = ("cylinder", "radius, mm", "axis from, mm", "to, mm", "posterior", "outlines")


def cylinder_rows(cylinders: Cylinders) -> list[tuple[str, ...]]:
    """What TABLE_HEAD says of each."""
    return [
        (
            str(row),
            _radius(cylinders, row),
            *(", ".join(with_decimals(x, 2) for x in end.tolist()) for end in axis),
            with_decimals(float(cylinders.posterior[row]), 3),
            str(int((cylinders.cylinder == row).sum())),
        )
        for row, axis in enumerate(cylinders.axis_mm)
    ]


def _radius(cylinders: Cylinders, row: int) -> str:
    return with_sigma(float(cylinders.radius_mm[row]), float(cylinders.radius_sigma_mm[row]))
