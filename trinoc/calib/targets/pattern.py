"""The printed sheet of the method: circles and two crossed lines on the plane Z = 0."""

import dataclasses
from typing import ClassVar, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.targets.abstract_target import AbstractBoard, Disc, Marks, Polygon
from trinoc.calib.targets.ring_code import ring_code
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import InputError, real_number, whole_number
from trinoc.numerics.display import Displayable
from trinoc.numerics.precision import ArrayLike, real_array

LINE_STYLES = ("stop", "through", "white")

# numerical: points per arc of the region where a white line covers a circle, in drawings.
_ARC_POINTS = 48


# Completes messages about an argument that must be a sheet.
A_PATTERN = "a trinoc.Pattern, such as load_pattern reads from a file"


class Pattern(Displayable, AbstractBoard):
    """Sheet with circles (discs or rings) and two crossed lines in the plane Z = 0, in mm.

    The lines lie along X and Y and cross at the origin of the world. Seen from the printed side, X
    points right and Y up; Z points out of the sheet.

    Attributes
    ----------
    name : name of the sheet.
    centres_mm : (n, 2) centres (X, Y) of the circles.
    radius_mm : (n,) outer radius of each circle.
    inner_radius_mm : (n,) radius of the white hole of a ring; 0 for a disc.
    lattice : (n, 2) integer lattice coordinates of each circle. Neighbours in the lattice differ by
        one in one coordinate.
    line_width_mm : width of the crossed lines; 0 for a sheet without lines.
    line_half_length_mm : (2,) half the length of the line along X and of the line along Y. The
        middle of both lines is the origin.
    line_style : drawing of a line at a circle. "stop": the line ends `line_gap_mm` before the
        circle. "through": the line crosses the circle in black. "white": the line crosses the
        circle in white. A line between two rows of circles meets no circle.
    line_gap_mm : gap between a circle and the end of a line, for the style "stop".
    """

    kind: ClassVar[str] = "sheet"
    point_kind: ClassVar[str] = "circles"

    name: str = eqx.field(static=True)
    centres_mm: Float[np.ndarray, "n 2"]
    radius_mm: Float[np.ndarray, "n"]
    inner_radius_mm: Float[np.ndarray, "n"]
    lattice: Int[np.ndarray, "n 2"]
    line_width_mm: float = eqx.field(static=True)
    line_half_length_mm: tuple[float, float] = eqx.field(static=True)
    line_style: str = eqx.field(static=True)
    line_gap_mm: float = eqx.field(static=True)

    def __check_init__(self) -> None:
        problem = _problem(self, TUNING)
        if problem is not None:
            raise InputError(f"The pattern {self.name!r} cannot be printed: {problem}.")

    @classmethod
    def default(cls) -> "Pattern":
        """Standard sheet, as in `patterns/`: 8 x 8 circles with rings, radius 6 mm, pitch 20 mm."""
        return cls.cross_grid(rows=8, columns=8, pitch_mm=20.0, radius_mm=6.0)

    @classmethod
    def cross_grid(
        cls,
        *,
        rows: int,
        columns: int,
        pitch_mm: float,
        radius_mm: float,
        rings: Bool[ArrayLike, "rows columns"] | Literal["code", "none"] = "code",
        inner_radius_mm: float | None = None,
        line_width_mm: float = 1.0,
        line_half_length_mm: tuple[float, float] | None = None,
        line_style: str = "stop",
        line_gap_mm: float = 1.5,
        name: str | None = None,
    ) -> "Pattern":
        """Make a sheet with a grid of circles centred on the origin, and the crossed lines.

        The circles are ordered row by row from the top left. With even numbers of rows and
        columns, the lines run between the rows and meet no circle.

        Parameters
        ----------
        rows, columns : numbers of circles.
        pitch_mm : distance between neighbouring centres.
        radius_mm : outer radius of the circles.
        rings : (rows, columns) mask of the rings, row 0 on top. "code" chooses rings so that a
            partly visible sheet can be labelled (`trinoc.calib.targets.ring_code`). "none" makes
            all circles discs; an image cannot show the orientation of such a sheet.
        inner_radius_mm : radius of the white hole of a ring; half the outer radius if None.
        line_width_mm : width of the crossed lines; 0 for no lines.
        line_half_length_mm : half the lengths of the lines along X and Y. If None, lines end
            0.75 `pitch_mm` beyond the outer centres.
        line_style, line_gap_mm : see `Pattern`.
        name : name of the sheet; made from its sizes if None.

        Raises
        ------
        InputError : circles overlap, a size is not positive, or `rings` has the wrong shape.
        """
        rows, columns = whole_number(rows, "rows"), whole_number(columns, "columns")
        pitch_mm, radius_mm = real_number(pitch_mm, "pitch_mm"), real_number(radius_mm, "radius_mm")
        if rows < 1 or columns < 1:
            raise InputError(
                f"A grid of {rows} x {columns} circles is empty: give at least 1 row and 1 column."
            )
        if not isinstance(rings, str):
            is_ring = np.asarray(rings, dtype=bool)
            if is_ring.shape != (rows, columns):
                raise InputError(
                    f"`rings` has the shape {is_ring.shape}; give ({rows}, {columns})."
                )
        elif rings == "code":
            is_ring = ring_code(rows, columns)
        elif rings == "none":
            is_ring = np.zeros((rows, columns), dtype=bool)
        else:
            raise InputError(f'`rings` is {rings!r}; give "code", "none" or an array.')
        hole_mm = 0.5 * radius_mm
        if inner_radius_mm is not None:
            hole_mm = real_number(inner_radius_mm, "inner_radius_mm")
        if line_half_length_mm is None:
            line_half_length_mm = (0.5 * pitch_mm * (columns + 0.5), 0.5 * pitch_mm * (rows + 0.5))
        halves = real_array(line_half_length_mm, "line_half_length_mm")
        if halves.shape != (2,):
            raise InputError(
                f"line_half_length_mm is {line_half_length_mm}: give two lengths (x, y)."
            )
        half_x_mm, half_y_mm = halves
        row, column = np.divmod(np.arange(rows * columns), columns)
        lattice = np.stack([column, rows - 1 - row], axis=1)
        middle = np.array([0.5 * (columns - 1), 0.5 * (rows - 1)])
        return cls(
            name=name or f"cross_{rows}x{columns}_{pitch_mm:g}mm",
            centres_mm=pitch_mm * (lattice - middle),
            radius_mm=np.full(rows * columns, float(radius_mm)),
            inner_radius_mm=np.where(is_ring.ravel(), float(hole_mm), 0.0),
            lattice=lattice,
            line_width_mm=real_number(line_width_mm, "line_width_mm"),
            line_half_length_mm=(float(half_x_mm), float(half_y_mm)),
            line_style=line_style,
            line_gap_mm=real_number(line_gap_mm, "line_gap_mm"),
        )

    @classmethod
    def circle_grid(
        cls, *, rows: int, columns: int, pitch_mm: float, radius_mm: float, name: str | None = None
    ) -> "Pattern":
        """Make a plain grid of discs: OpenCV's symmetric grid, BoofCV's regular circle grid.

        The circles are ordered row by row from the top left, as `cv2.findCirclesGrid` does
        with patternSize = (columns, rows). The origin is the centre of the grid; that of
        OpenCV is the first circle.

        Parameters
        ----------
        rows, columns : numbers of circles.
        pitch_mm : distance between neighbouring centres.
        radius_mm : radius of the circles.
        name : name of the sheet; made from its sizes if None.

        Raises
        ------
        InputError : circles overlap, or a size is not positive.
        """
        return cls.cross_grid(
            rows=rows,
            columns=columns,
            pitch_mm=pitch_mm,
            radius_mm=radius_mm,
            rings="none",
            line_width_mm=0.0,
            line_half_length_mm=(0.0, 0.0),
            line_gap_mm=0.0,
            name=name or f"circles_{rows}x{columns}_{real_number(pitch_mm, 'pitch_mm'):g}mm",
        )

    @classmethod
    def asymmetric_circle_grid(
        cls,
        *,
        rows: int,
        columns: int,
        spacing_mm: float,
        radius_mm: float,
        name: str | None = None,
    ) -> "Pattern":
        """Make OpenCV's asymmetric grid: every second row is shifted by half a column distance.

        The circles are ordered row by row; the first row is not shifted. OpenCV's object points
        are ((2 j + i mod 2) s, i s). Here the second axis points up, and the origin is the centre
        of the grid.

        Parameters
        ----------
        rows, columns : numbers of circles. OpenCV's patternSize is (columns, rows), such as
            (4, 11).
        spacing_mm : distance between rows. Circles in one row are 2 `spacing_mm` apart.
        radius_mm : radius of the circles.
        name : name of the sheet; made from its sizes if None.

        Raises
        ------
        InputError : circles overlap, or a size is not positive.
        """
        spacing_mm = real_number(spacing_mm, "spacing_mm")
        even = cls.circle_grid(
            rows=rows,
            columns=columns,
            pitch_mm=2 * spacing_mm,
            radius_mm=radius_mm,
            name=name or f"asymmetric_circles_{rows}x{columns}_{spacing_mm:g}mm",
        )
        down, column = np.divmod(np.arange(rows * columns), columns)
        across = 2 * column + down % 2
        centres_mm = spacing_mm * np.stack([across, -down], axis=1).astype(float)
        centres_mm -= 0.5 * (centres_mm.min(axis=0) + centres_mm.max(axis=0))
        # The nearest circles are the diagonal ones, so the lattice is turned by 45 degrees.
        lattice = np.stack([(across + down) // 2, (across - down) // 2], axis=1)
        return dataclasses.replace(even, centres_mm=centres_mm, lattice=lattice)

    @property
    def is_ring(self) -> Bool[np.ndarray, "n"]:
        """Mask of the rings; False marks a disc."""
        return self.inner_radius_mm > 0.0

    @property
    def marks(self) -> Marks:
        """Features that distinguish a sheet of circles from other boards.

        They are the same for all sheets of circles, because an image cannot distinguish two of
        them.
        """
        likeness = (
            "both are sheets of circles, but a set may contain only one such sheet; use other "
            "boards"
        )
        return Marks("circles", range(1), likeness)

    def drawing(self) -> list[Disc | Polygon]:
        """Shapes of the circles and crossed lines. Their painting order depends on `line_style`."""
        circles: list[Disc | Polygon] = []
        centres, radii = [(x, y) for x, y in self.centres_mm.tolist()], self.radius_mm.tolist()
        for centre, radius, hole in zip(centres, radii, self.inner_radius_mm.tolist(), strict=True):
            circles.append(Disc(centre, radius, True))
            if hole > 0:
                circles.append(Disc(centre, hole, False))
        if self.line_width_mm == 0:
            return circles
        half_x_mm, half_y_mm = self.line_half_length_mm
        thin_mm = 0.5 * self.line_width_mm
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        reaches = (half_x_mm, thin_mm), (thin_mm, half_y_mm)
        lines = [Polygon(corners * reach, True) for reach in reaches]
        clearance_mm = self.radius_mm + self.line_gap_mm + thin_mm
        crossings = [
            (int(circle), axis)
            for axis in (0, 1)
            for circle in np.flatnonzero(np.abs(self.centres_mm[:, 1 - axis]) < clearance_mm)
        ]
        if self.line_style == "through":
            return [*circles, *lines]
        if self.line_style == "white":
            return [*lines, *circles, *(_line_on_circle(self, *crossing) for crossing in crossings)]
        gaps = [Disc(centres[k], radii[k] + self.line_gap_mm, False) for k, _ in crossings]
        return [*lines, *gaps, *circles]

    def rescale(self, scale_x: float, scale_y: float) -> "Pattern":
        """Scale the sheet separately along X and Y, to correct the scale errors of a printer.

        Parameters
        ----------
        scale_x, scale_y : measured length of the scale bar along X or Y, divided by its nominal
            length.

        Notes
        -----
        Radii are scaled by the geometric mean of both factors. For factors that differ by 0.1 %,
        this moves the edge of a circle by a few micrometres at most.
        """
        mean = float(np.sqrt(scale_x * scale_y))
        half_x_mm, half_y_mm = self.line_half_length_mm
        return dataclasses.replace(
            self,
            centres_mm=self.centres_mm * np.array([scale_x, scale_y]),
            radius_mm=self.radius_mm * mean,
            inner_radius_mm=self.inner_radius_mm * mean,
            line_width_mm=self.line_width_mm * mean,
            line_half_length_mm=(half_x_mm * scale_x, half_y_mm * scale_y),
            line_gap_mm=self.line_gap_mm * mean,
        )


def _line_on_circle(pattern: Pattern, circle: int, axis: int) -> Polygon:
    """Part of a circle that a white line covers, as a polygon with finely divided arcs.

    axis : direction of the line, 0 for X and 1 for Y.
    """
    radius, thin = float(pattern.radius_mm[circle]), 0.5 * pattern.line_width_mm
    across = pattern.centres_mm[circle][1 - axis]
    low = np.arcsin(np.clip((-thin - across) / radius, -1.0, 1.0))
    high = np.arcsin(np.clip((thin - across) / radius, -1.0, 1.0))
    right = np.linspace(low, high, _ARC_POINTS)
    angle = np.concatenate([right, np.pi - right[::-1]])
    along_across = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    turned = along_across if axis == 0 else along_across[:, ::-1]
    return Polygon(pattern.centres_mm[circle] + turned, False)


def _problem(pattern: Pattern, tuning: CalibTuning) -> str | None:
    """Return the reason why a layout cannot be printed, as part of a sentence; else None."""
    centres, radius = pattern.centres_mm, pattern.radius_mm
    if len(centres) == 0:
        return "it has no circle"
    numbers = [centres, radius, pattern.inner_radius_mm, pattern.line_half_length_mm]
    numbers += [pattern.line_width_mm, pattern.line_gap_mm]
    if not all(np.all(np.isfinite(number)) for number in numbers):
        return "a number is not finite"
    if np.any(radius <= 0.0):
        return f"circle {int(np.argmin(radius))} has a radius that is not positive"
    if np.any((pattern.inner_radius_mm < 0.0) | (pattern.inner_radius_mm >= radius)):
        worst = int(np.argmax(pattern.inner_radius_mm - radius))
        return f"the hole of circle {worst} is not between 0 and its radius"
    if min(pattern.line_width_mm, pattern.line_gap_mm, *pattern.line_half_length_mm) < 0.0:
        return "the width, the gap or the length of the lines is negative"
    if pattern.line_style not in LINE_STYLES:
        return f"the line style {pattern.line_style!r} is none of {', '.join(LINE_STYLES)}"
    if len(np.unique(pattern.lattice, axis=0)) != len(centres):
        return "two circles have the same lattice coordinates"
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    if np.any(distance <= radius[:, None] + radius[None]):
        first, second = np.argwhere(distance <= radius[:, None] + radius[None])[0]
        return f"circles {first} and {second} overlap"
    return _lattice_problem(pattern, tuning)


def _lattice_problem(pattern: Pattern, tuning: CalibTuning) -> str | None:
    """Return the reason why the circle centres do not form the stated lattice; else None.

    The reason is part of a sentence. The map from lattice coordinates to the sheet must be affine
    without a reflection.
    """
    relative = pattern.lattice - pattern.lattice.mean(axis=0)
    steps, _, rank, _ = np.linalg.lstsq(relative, pattern.centres_mm, rcond=None)
    if rank < 2:
        return None
    area_mm2 = np.linalg.det(steps)
    if area_mm2 <= 0.0:
        return "its lattice is a mirror image of its centres"
    deviation_mm = np.abs(relative @ steps + pattern.centres_mm.mean(axis=0) - pattern.centres_mm)
    if deviation_mm.max() > tuning.targets.off_lattice * np.sqrt(area_mm2):
        return "its centres do not lie on the lattice that it states"
    return None
