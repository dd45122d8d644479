"""Uncertainty over the field: of epipolar lines across each picture, of points in space."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib import Pattern, epipolar_sigma, point_covariance
from trinoc.geometry import Rig
from trinoc.match import Matches
from trinoc.report.numbers import decimals_for, with_decimals
from trinoc.report.pictures import PagePicture, Window
from trinoc.report.space_content import content_box

PLACES = 5


class Scale(NamedTuple):
    """What makes the numbers of a map short: its largest, and thousandths where that is small."""

    largest: float
    thousandths: bool
    decimals: int

    @classmethod
    def of(cls, values: Float[np.ndarray, "n"]) -> "Scale":
        """Two digits of the largest, no more than four for the others."""
        finite = values[np.isfinite(values)]
        largest = max(float(finite.max()), 1e-12) if len(finite) else 1.0
        small = largest < 0.05
        return cls(largest, small, min(2, decimals_for(largest * (1000 if small else 1))))

    def text(self, value: float) -> str:
        """A number of the map."""
        return f"{value * (1000 if self.thousandths else 1):.{self.decimals}f}"


class FieldCell(NamedTuple):
    """A part of a map: its middle, its number, and how dark it is (0 to 1)."""

    u: float
    v: float
    text: str
    shade: float


class FieldMap(NamedTuple):
    """A grid of numbers over a picture, or over the sheet where `picture` is None."""

    name: str
    caption: str
    picture: PagePicture | None
    window: Window
    cell_width: float
    cell_height: float
    cells: tuple[FieldCell, ...]


class FieldPart(NamedTuple):
    """Maps of epipolar lines (px) and of points in space (mm); sigmas of the cameras alone.

    `middle_mm` is the largest sigma of a point in the middle of the lowest map; `worst_px` the
    largest sigma of an epipolar line anywhere.
    """

    pictures: tuple[FieldMap, ...]
    planes: tuple[FieldMap, ...]
    middle_mm: float
    worst_px: float


def field_part(
    rig: Rig,
    pattern: Pattern | None,
    matches: Matches | None,
    pictures: dict[str, PagePicture],
) -> FieldPart | None:
    """The maps; None for a rig that does not know its errors, or has one camera."""
    if not len(rig.parameters) or len(rig) < 2:
        return None
    sigmas = {
        name: np.stack([epipolar_sigma(rig, name, o).sigma_px for o in rig if o != name]).max(0)
        for name in rig
    }
    places = {name: epipolar_sigma(rig, name, _other(rig, name)).uv_px for name in rig}
    everything = np.concatenate(list(sigmas.values()))
    scale = Scale.of(everything)
    maps = tuple(
        _picture_map(name, pictures[name], places[name], sigmas[name], scale) for name in rig
    )
    planes, middle = _planes(rig, pattern, matches)
    finite = everything[np.isfinite(everything)]
    return FieldPart(maps, planes, middle, float(finite.max()) if len(finite) else np.nan)


def _other(rig: Rig, name: str) -> str:
    return next(other for other in rig if other != name)


def _picture_map(
    name: str,
    picture: PagePicture,
    uv_px: Float[np.ndarray, "n 2"],
    sigma_px: Float[np.ndarray, "n"],
    scale: Scale,
) -> FieldMap:
    width, height = picture.width_px / PLACES, picture.height_px / PLACES
    # The places lie on the picture's edge; a cell of the map stands inside.
    share = uv_px / (np.array([picture.width_px, picture.height_px]) - 1)
    middles = share * [picture.width_px - width, picture.height_px - height] + [
        width / 2 - 0.5,
        height / 2 - 0.5,
    ]
    cells = tuple(_cells(middles, sigma_px, scale))
    caption = f"sigma across epipolar lines, {'thousandths of a px' if scale.thousandths else 'px'}"
    return FieldMap(name, caption, picture, picture.window, width, height, cells)


def _planes(
    rig: Rig, pattern: Pattern | None, matches: Matches | None
) -> tuple[tuple[FieldMap, ...], float]:
    """Maps of two levels, the lower and the upper end of what the rig looks at."""
    box = content_box(pattern, matches)
    if box is None:
        return (), np.nan
    size = box.high_mm - box.low_mm
    flat = matches is None or not len(matches)
    heights = (0.0, 0.25 * float(size[:2].max())) if flat else (box.low_mm[2], box.high_mm[2])
    step = size[:2] / PLACES
    x = box.low_mm[0] + step[0] * (np.arange(PLACES) + 0.5)
    y = box.low_mm[1] + step[1] * (np.arange(PLACES) + 0.5)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    levels = [_point_sigmas(rig, grid, float(height)) for height in heights]
    scale = Scale.of(np.concatenate(levels))
    window = Window(float(box.low_mm[0]), float(-box.high_mm[1]), float(size[0]), float(size[1]))
    maps = tuple(
        FieldMap(
            f"Z = {with_decimals(height, 0)} mm",
            f"largest sigma of a point there, {'µm' if scale.thousandths else 'mm'}",
            None,
            window,
            float(step[0]),
            float(step[1]),
            tuple(_cells(grid * [1, -1], sigma, scale)),
        )
        for height, sigma in zip(heights, levels, strict=True)
    )
    return maps, float(levels[0][len(grid) // 2])


def _point_sigmas(
    rig: Rig, xy_mm: Float[np.ndarray, "n 2"], height_mm: float
) -> Float[np.ndarray, "n"]:
    """Along the worst direction, for points that all cameras see exactly."""
    sigmas = []
    for x, y in xy_mm:
        covariance = point_covariance(rig, np.array([x, y, height_mm]))
        known = np.isfinite(covariance).all()
        largest = np.linalg.eigvalsh(covariance)[-1] if known else np.nan
        sigmas.append(np.sqrt(max(float(largest), 0.0)) if known else np.nan)
    return np.array(sigmas)


def _cells(
    middles: Float[np.ndarray, "n 2"], sigma: Float[np.ndarray, "n"], scale: Scale
) -> list[FieldCell]:
    return [
        FieldCell(float(u), float(v), scale.text(float(s)), float(np.clip(s / scale.largest, 0, 1)))
        if np.isfinite(s)
        else FieldCell(float(u), float(v), "?", 0.0)
        for (u, v), s in zip(middles, sigma, strict=True)
    ]
