"""The cameras and the boards of all shots in space."""

import numpy as np

from trinoc.calib import RigFromShots, board_names, boards_of
from trinoc.report.plan_part import Drawing, plan_and_elevation
from trinoc.report.space_content import Box, frusta
from trinoc.report.space_part import Label, Layer, SpaceFigure, View

_ROOM = 0.05


def boards_in_space(result: RigFromShots) -> SpaceFigure | None:
    """The figure to turn; None without a rig."""
    if result.rig is None:
        return None
    boards, box = _boards(result), _box(result)
    count = len(result.world_from_board)
    reach = 0.1 * float(np.max(box.high_mm - box.low_mm))
    axes = [np.stack([np.zeros(3), reach * axis]) for axis in np.eye(3)]
    layers = (
        Layer(f"boards ({count})", "sheet", boards, True, (), _shots(result)),
        Layer(f"world axes, {reach:.0f} mm long", "axes", axes),
        Layer("cameras", "cameras", frusta(result.rig)),
    )
    labels = [Label(1.08 * axis[1], name, "axes") for axis, name in zip(axes, "XYZ", strict=True)]
    labels += [Label(c.centre_world_mm, name, "cameras") for name, c in result.rig.items()]
    return SpaceFigure(layers, tuple(labels), (View("Whole rig", box),))


def plans_of_boards(result: RigFromShots) -> tuple[Drawing, ...]:
    """Plan and elevation; empty without a rig."""
    if result.rig is None:
        return ()
    lines = [(_boards(result), "sheet", -1), (frusta(result.rig), "cameras", -1)]
    names = [(camera.centre_world_mm, name) for name, camera in result.rig.items()]
    return plan_and_elevation(_box(result), lines, names)


def _boards(result: RigFromShots) -> list[np.ndarray]:
    """The outline of the places of each board in each shot."""
    outlines = []
    for board, fixed in zip(boards_of(result.target), result.reference_from_board, strict=True):
        centres = np.asarray(board.centres_mm)
        (left, top), (right, bottom) = centres.min(axis=0), centres.max(axis=0)
        corners = [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]]
        outlines.append(np.array(corners) @ fixed[:, :2].T + fixed[:, 3])
    return [
        places @ pose[:, :3].T + pose[:, 3]
        for pose in result.world_from_board
        for places in outlines
    ]


def _shots(result: RigFromShots) -> tuple[str, ...]:
    names = board_names(result.target)
    which = [f"board {name}" for name in names] if len(names) > 1 else ["board"]
    return tuple(f"{each} in shot {shot}" for shot in result.shots for each in which)


def _box(result: RigFromShots) -> Box:
    assert result.rig is not None
    points = np.concatenate([*frusta(result.rig), *_boards(result)])
    low, high = points.min(axis=0), points.max(axis=0)
    room = _ROOM * float(np.max(high - low))
    return Box(low - room, high + room)
