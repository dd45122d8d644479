"""Where in each camera's field two halves of the shots disagree, in px and in claimed sigmas."""

from typing import NamedTuple

import numpy as np

from trinoc.calib import RigFromShots
from trinoc.report.field_part import PLACES
from trinoc.report.numbers import with_decimals
from trinoc.report.pictures import PagePicture

# So many claimed sigmas are as dark as a tile becomes.
_DARKEST = 3.0


class HalvesCell(NamedTuple):
    """A part of the picture: its middle, px, claimed sigmas, how dark it is, and all in words."""

    u: float
    v: float
    px: str
    sigmas: str
    shade: float
    words: str


class HalvesMap(NamedTuple):
    """One camera's at one distance; a cell is `cell_width` by `cell_height`, px."""

    name: str
    caption: str
    picture: PagePicture
    cell_width: float
    cell_height: float
    cells: tuple[HalvesCell, ...]


def halves_maps(result: RigFromShots) -> tuple[tuple[HalvesMap, ...], ...]:
    """Maps of the cameras at the distance of the boards, and farther; nothing without halves."""
    if result.rig is None or result.halves is None or not result.halves.over_field:
        return ()
    return tuple(
        tuple(_map(result, number, farther) for number in range(len(result.cameras)))
        for farther in (0, 1)
    )


def _map(result: RigFromShots, number: int, farther: int) -> HalvesMap:
    assert result.rig is not None
    assert result.halves is not None
    field = result.halves.over_field[number]
    width, height = result.rig[field.camera].image_size_px
    difference, over = field.difference_px[farther], field.over_sigma[farther]
    length = np.linalg.norm(difference, axis=1)
    cells = tuple(
        _cell(uv, *said)
        for uv, *said in zip(
            field.uv_px, difference, field.sigma_px[farther], over, length, strict=True
        )
    )
    caption = (
        f"{with_decimals(float(field.distance_mm[farther]), 0)} mm away, "
        f"{with_decimals(float(field.rms_over_sigma[farther]), 2)} sigmas rms"
    )
    picture = PagePicture(field.camera, width, height, "")
    return HalvesMap(field.camera, caption, picture, width / PLACES, height / PLACES, cells)


def _cell(
    uv: np.ndarray, difference: np.ndarray, sigma_px: float, over: float, length: float
) -> HalvesCell:
    u, v = (float(x) for x in uv)
    if not np.isfinite(over):
        return HalvesCell(u, v, "\N{EN DASH}", "", 0.0, "no ray of the lens")
    du, dv = (f"{x:+.2g}" for x in difference)
    words = f"({du}, {dv}) px; claimed are {sigma_px:.2g} px per axis"
    shade = min(float(over) / _DARKEST, 1.0)
    px = f"{length:.2g}" if length >= 0.01 else f"{length:.1g}"
    return HalvesCell(u, v, px, f"{over:.1f} \N{GREEK SMALL LETTER SIGMA}", shade, words)
