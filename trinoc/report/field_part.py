"""Uncertainty over the field: of epipolar lines, of points, of pixels, and between halves."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.pixel_sigma import PixelSigma, rig_of_known_size
from trinoc.calib.uncertainty.propagation import epipolar_sigma, point_covariance, projection_sigma
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import Matches
from trinoc.report.numbers import significant_decimals, with_decimals
from trinoc.report.pictures import PagePicture, Window
from trinoc.report.space_content import content_box

# Numbers of a map along each side.
PLACES = 5
# Levels of points in space below, within and above what the rig looks at.
LEVELS = (3, 5, 3)
# Distances of points from a camera, over that of the boards; at the last, poses hardly matter.
DISTANCES = (0.5, 0.7, 1.0, 1.5, 2.0, TUNING.advice.farther, 5.0, 10.0, 100.0)
# Reported sigmas between two halves at which a tile is darkest.
_DARKEST = 3.0


class Scale(NamedTuple):
    """Common scale and unit of the numbers in a group of maps.

    Attributes
    ----------
    largest : float
        Largest number, which has the darkest shade.
    thousandths : bool
        True if the numbers are shown in thousandths of their unit.
    decimals : int
        Decimals of the numbers.
    """

    largest: float
    thousandths: bool
    decimals: int

    @classmethod
    def of(cls, values: Float[np.ndarray, "n"]) -> "Scale":
        """Create the scale of maps that show these values, (n,).

        Decimals are chosen so that the largest value has about two significant digits. If it is
        below 0.05, the maps show all values in thousandths of their unit.
        """
        finite = values[np.isfinite(values)]
        largest = max(float(finite.max()), 1e-12) if len(finite) else 1.0
        small = largest < 0.05
        return cls(largest, small, min(2, significant_decimals(largest * (1000 if small else 1))))

    @property
    def px(self) -> str:
        """Unit of the shown numbers, as text, if the values are in px."""
        return "thousandths of a px" if self.thousandths else "px"

    def cell(self, value: float) -> "FieldCell":
        """Cell of a map that shows a value; "?" for NaN."""
        if not np.isfinite(value):
            return FieldCell("?", 0.0)
        text = f"{value * (1000 if self.thousandths else 1):.{self.decimals}f}"
        return FieldCell(text, float(np.clip(value / self.largest, 0, 1)))


class FieldCell(NamedTuple):
    """Cell of a map.

    Attributes
    ----------
    text : str
        Number that the cell shows.
    shade : float
        Darkness, 0 to 1.
    below : str
        Second number, below the first.
    description : str
        Text that appears when the reader points at the cell.
    """

    text: str
    shade: float
    below: str = ""
    description: str = ""


class FieldMap(NamedTuple):
    """Map of cells over an image or over the sheet.

    Attributes
    ----------
    name : str
        Name of the camera or of the plane.
    caption : str
        Caption of the map.
    picture : PagePicture or None
        Image below the map; None for a map over the sheet.
    window : Window
        Region of the map, in px or mm.
    cell : (width, height)
        Size of a cell.
    middles : (n, 2)
        Middles of the cells.
    cells : tuple of FieldCell
        The n cells, row by row.
    """

    name: str
    caption: str
    picture: PagePicture | None
    window: Window
    cell: tuple[float, float]
    middles: Float[np.ndarray, "n 2"]
    cells: tuple[FieldCell, ...]


class FieldLevel(NamedTuple):
    """Maps for one height above the sheet or one distance from the cameras.

    Attributes
    ----------
    name : str
        Height or distance, as text.
    maps : tuple of FieldMap
        One map for the rig, or one for each camera.
    stands : bool
        True if the maps are visible when the page opens and on paper.
    """

    name: str
    maps: tuple[FieldMap, ...]
    stands: bool


class FieldPart(NamedTuple):
    """Section with maps of the sigmas that the errors of the cameras cause, of epipolar lines in
    the images (px) and of 3-D points near the sheet (mm).

    Attributes
    ----------
    pictures : tuple of FieldMap
        Over each image: sigma of a point's distance from its epipolar line, px.
    planes : tuple of FieldLevel
        In planes parallel to the sheet: sigma of a point in space, mm, in its worst direction.
    worst_mm : float
        Largest sigma in the planes that are visible when the page opens. The sigma in the middle,
        where all optical axes meet, would be misleadingly small.
    """

    pictures: tuple[FieldMap, ...]
    planes: tuple[FieldLevel, ...]
    worst_mm: float


class Uncertainty(NamedTuple):
    """Section with the sigma of the pixel at which each camera images a point, for a rig from
    shots.

    The size of the board is assumed exact.

    Attributes
    ----------
    levels : tuple of FieldLevel
        Maps at several distances from the cameras, the nearest at half the distance of the boards.
    worst_farther_px : float
        Largest sigma at a distance beyond the boards. When the page opens, it shows the maps of
        this distance and of the distance of the boards.
    at_boards : PixelSigma
        Summary at the distance of the boards.
    """

    levels: tuple[FieldLevel, ...]
    worst_farther_px: float
    at_boards: PixelSigma


def _over_picture(
    name: str, caption: str, picture: PagePicture, cells: Sequence[FieldCell]
) -> FieldMap:
    """Map of equal cells over an image, row by row, with these contents."""
    cell = np.array([picture.width_px, picture.height_px]) / PLACES
    grid = np.stack(np.meshgrid(np.arange(PLACES), np.arange(PLACES)), axis=-1).reshape(-1, 2)
    middles = (grid + 0.5) * cell - 0.5
    return FieldMap(
        name,
        caption,
        picture,
        picture.window,
        (float(cell[0]), float(cell[1])),
        middles,
        tuple(cells),
    )


def field_part(
    rig: Rig,
    pattern: Pattern | None,
    matches: Matches | None,
    pictures: dict[str, PagePicture],
) -> FieldPart | None:
    """Section with maps of the sigmas that the errors of the cameras cause, of epipolar lines in
    the images (px) and of 3-D points near the sheet (mm).

    Returns None for one camera, or for a rig without a covariance.
    """
    if not len(rig.parameters) or len(rig) < 2:
        return None
    worst = {
        name: np.stack([epipolar_sigma(rig, name, o).sigma_px for o in rig if o != name]).max(0)
        for name in rig
    }
    scale = Scale.of(np.concatenate(list(worst.values())))
    maps = tuple(
        _over_picture(
            name,
            f"sigma across epipolar lines, {scale.px}",
            pictures[name],
            [scale.cell(float(sigma)) for sigma in sigmas],
        )
        for name, sigmas in worst.items()
    )
    return FieldPart(maps, *_planes(rig, pattern, matches))


def _planes(
    rig: Rig, pattern: Pattern | None, matches: Matches | None
) -> tuple[tuple[FieldLevel, ...], float]:
    """Maps of the sigma of a point in planes parallel to the sheet, and the largest sigma, mm.

    The planes at the lower and the upper end of the segments, or near the sheet, are shown first.
    """
    box = content_box(pattern, matches)
    if box is None:
        return (), np.nan
    size = box.high_mm - box.low_mm
    side = float(size[:2].max())
    is_empty = matches is None or not len(matches)
    low, high = (0.0, 0.25 * side) if is_empty else (float(box.low_mm[2]), float(box.high_mm[2]))
    below, within, above = LEVELS
    heights = np.concatenate(
        [
            np.linspace(low - side, low, below, endpoint=False),
            np.linspace(low, high, within),
            np.linspace(high, high + side, above + 1)[1:],
        ]
    )
    step = size[:2] / PLACES
    x = box.low_mm[0] + step[0] * (np.arange(PLACES) + 0.5)
    y = box.low_mm[1] + step[1] * (np.arange(PLACES) + 0.5)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    sigmas = [_point_sigmas(rig, grid, float(height)) for height in heights]
    scale = Scale.of(np.concatenate([sigmas[below], sigmas[below + within - 1]]))
    window = Window(float(box.low_mm[0]), float(-box.high_mm[1]), float(size[0]), float(size[1]))
    caption = (
        f"largest sigma of a point there, {'µm' if scale.thousandths else 'mm'}; seen from above, "
        f"{size[0]:.0f} x {size[1]:.0f} mm"
    )
    levels = []
    for height, sigma in zip(heights, sigmas, strict=True):
        name = f"Z = {with_decimals(height, 0)} mm"
        cells = tuple(scale.cell(float(one)) for one in sigma)
        cell = (float(step[0]), float(step[1]))
        map_ = FieldMap(name, caption, None, window, cell, grid * [1, -1], cells)
        levels.append(FieldLevel(name, (map_,), height in (low, high)))
    return tuple(levels), scale.largest


def _point_sigmas(
    rig: Rig, xy_mm: Float[np.ndarray, "n 2"], height_mm: float
) -> Float[np.ndarray, "n"]:
    """Sigma of points at one height in their worst direction, mm, from the errors of the cameras.

    The pixels of the points are assumed exact. xy_mm : (n, 2) positions in the plane.
    """
    covariance = point_covariance(rig, np.insert(xy_mm, 2, height_mm, axis=1))
    valid = np.isfinite(covariance).all(axis=(1, 2))
    sigmas = np.full(len(xy_mm), np.nan)
    sigmas[valid] = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[valid])[:, -1], 0.0))
    return sigmas


def uncertainty_maps(result: CalibrationResult) -> Uncertainty | None:
    """Section with the sigma of the pixel at which each camera images a point.

    The size of the board is assumed exact. Returns None without a rig or its covariance.
    """
    pixel_sigma = result.pixel_sigma
    if pixel_sigma is None:
        return None
    levels, worst = [], {}
    rig = rig_of_known_size(result.rig, result.parameters, result.covariance)
    for times in DISTANCES:
        maps, worst[times] = _draw_maps(result, rig, times)
        name = f"{times:g} times as far as the boards"
        levels.append(FieldLevel(name, maps, times in (1.0, TUNING.advice.farther)))
    return Uncertainty(tuple(levels), worst[TUNING.advice.farther], pixel_sigma)


def _draw_maps(
    result: CalibrationResult, rig: Rig, times: float
) -> tuple[tuple[FieldMap, ...], float]:
    maps, worst = [], 0.0
    for name in result.cameras:
        distance = times * result.board_distance_mm(name)
        sigma_px = projection_sigma(rig, name, distance).sigma_px
        scale = Scale.of(sigma_px)
        caption = f"{with_decimals(distance, 0)} mm away, {scale.px}"
        picture = PagePicture(name, *rig[name].image_size_px, "")
        cells = [scale.cell(float(sigma)) for sigma in sigma_px]
        maps.append(_over_picture(name, caption, picture, cells))
        worst = max(worst, float(sigma_px[np.isfinite(sigma_px)].max(initial=0.0)))
    return tuple(maps), worst


def halves_maps(result: CalibrationResult) -> tuple[tuple[FieldMap, ...], ...]:
    """Maps of the difference between the pixels that two calibrations predict for the same points.

    Each calibration uses one half of the shots. The cells show the difference in px and in reported
    sigmas. The first group of maps is for the distance of the boards, the second for a larger
    distance. Empty if the halves were not calibrated.
    """
    if not result.has_rig or result.halves is None or not result.halves.over_field:
        return ()
    maps = []
    for farther in (0, 1):
        for field in result.halves.over_field:
            columns = (field.difference_px, field.sigma_px, field.over_sigma)
            caption = (
                f"{with_decimals(float(field.distance_mm[farther]), 0)} mm away, "
                f"{with_decimals(float(field.rms_over_sigma[farther]), 2)} sigmas rms"
            )
            picture = PagePicture(field.camera, *result.rig[field.camera].image_size_px, "")
            cells = [_halves_cell(*each) for each in zip(*(column[farther] for column in columns))]
            maps.append(_over_picture(field.camera, caption, picture, cells))
    count = len(result.halves.over_field)
    return tuple(maps[:count]), tuple(maps[count:])


def _halves_cell(
    difference_px: Float[np.ndarray, "2"], sigma_px: float, over_sigma: float
) -> FieldCell:
    if not np.isfinite(over_sigma):
        return FieldCell("\N{EN DASH}", 0.0, " ", "no ray of the lens")
    length = float(np.linalg.norm(difference_px))
    px = f"{length:.2g}" if length >= 0.01 else f"{length:.1g}"
    du, dv = (f"{x:+.2g}" for x in difference_px)
    description = f"({du}, {dv}) px; claimed are {sigma_px:.2g} px per axis"
    shade = min(float(over_sigma) / _DARKEST, 1.0)
    return FieldCell(px, shade, f"{over_sigma:.1f} \N{GREEK SMALL LETTER SIGMA}", description)
