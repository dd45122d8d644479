"""How well each camera knows where it images a point, over its field and at two distances."""

from typing import NamedTuple

import numpy as np

from trinoc.calib import RigFromShots, boards_of, projection_sigma
from trinoc.report.field_part import PLACES, FieldCell, FieldMap, Scale
from trinoc.report.numbers import with_decimals
from trinoc.report.pictures import PagePicture

# Beyond the boards by so much: where users may measure, and where errors no longer cancel.
FARTHER = 3.0


class Uncertainty(NamedTuple):
    """Maps of the cameras at the boards and farther off; the largest numbers of each, px."""

    at_boards: tuple[FieldMap, ...]
    farther: tuple[FieldMap, ...]
    worst_at_boards_px: float
    worst_farther_px: float


def uncertainty_maps(result: RigFromShots) -> Uncertainty | None:
    """None for a fit without a rig, or one whose covariance holds nothing."""
    if result.rig is None or not len(result.rig.parameters):
        return None
    near = tuple(_map(result, camera, 1.0) for camera in result.cameras)
    far = tuple(_map(result, camera, FARTHER) for camera in result.cameras)
    return Uncertainty(
        tuple(one for one, _ in near),
        tuple(one for one, _ in far),
        max(worst for _, worst in near),
        max(worst for _, worst in far),
    )


def _map(result: RigFromShots, camera: str, times: float) -> tuple[FieldMap, float]:
    assert result.rig is not None
    distance = times * _distance_mm(result, camera)
    found = projection_sigma(result.rig, camera, distance)
    width, height = result.rig[camera].image_size_px
    part = np.array([width, height]) / PLACES
    share = found.uv_px / np.array([width - 1, height - 1])
    middles = share * (np.array([width, height]) - part) + part / 2 - 0.5
    scale = Scale.of(found.sigma_px)
    cells = tuple(
        FieldCell(float(u), float(v), scale.text(float(s)), float(np.clip(s / scale.largest, 0, 1)))
        for (u, v), s in zip(middles, found.sigma_px, strict=True)
    )
    caption = (
        f"{with_decimals(distance, 0)} mm away, "
        f"{'thousandths of a px' if scale.thousandths else 'px'}"
    )
    picture = PagePicture(camera, width, height, "")
    drawn = FieldMap(
        camera, caption, picture, picture.window, float(part[0]), float(part[1]), cells
    )
    return drawn, float(found.sigma_px.max())


def _distance_mm(result: RigFromShots, camera: str) -> float:
    """The median from the camera to the middle of the boards that it saw."""
    assert result.rig is not None
    number, middles = result.cameras.index(camera), _middles_mm(result)
    centre = result.rig[camera].centre_world_mm
    seen = {(v.shot, v.board) for v in result.views if v.camera == number and v.used.any()}
    seen = seen or {(shot, 0) for shot in range(len(result.world_from_board))}
    shots, which = np.array(sorted(seen)).T
    boards = result.world_from_board[shots]
    places = np.einsum("sij,sj->si", boards[:, :, :3], middles[which]) + boards[:, :, 3]
    return float(np.median(np.linalg.norm(places - centre, axis=1)))


def _middles_mm(result: RigFromShots) -> np.ndarray:
    """(b, 3) of the boards, in the frame of the first."""
    extents = [np.asarray(board.centres_mm) for board in boards_of(result.target)]
    middles = np.stack([(own.min(axis=0) + own.max(axis=0)) / 2 for own in extents])
    fixed = result.reference_from_board
    return np.einsum("bij,bj->bi", fixed[:, :, :2], middles) + fixed[:, :, 3]
