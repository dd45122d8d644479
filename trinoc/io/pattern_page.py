"""A sheet laid out on a page: figures in mm, from which SVG and PDF are drawn alike."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib import AbstractTarget, Pattern
from trinoc.errors import InputError
from trinoc.io.board_figures import ink_polygons

# (width, height) in mm, upright.
PAPER_SIZES_MM = {
    "a4": (210.0, 297.0),
    "letter": (215.9, 279.4),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
}
# What printers leave blank at the page's edges, and the room of the scale bars and the text.
_MARGIN_MM = 5.0
_BAR_GAP_MM = 9.0
_TEXT_ROOM_MM = 18.0
_BAR_STEP_MM = 10.0
_BAR_WIDTH_MM = 0.3
_TICK_MM = 4.0
LETTER_MM = 3.2
_ARC_POINTS = 48


class Disc(NamedTuple):
    """A filled circle."""

    centre_mm: tuple[float, float]
    radius_mm: float
    is_ink: bool


class Polygon(NamedTuple):
    """A filled polygon."""

    corners_mm: Float[np.ndarray, "n 2"]
    is_ink: bool


class Text(NamedTuple):
    """A line of text, its baseline's middle at `place_mm`, turned upward if `is_upright`."""

    place_mm: tuple[float, float]
    words: str
    is_upright: bool


class Page(NamedTuple):
    """Figures in painting order; mm from the page's middle, X to the right and Y up.

    bars_mm : nominal lengths of the two scale bars, along X and along Y.
    """

    title: str
    size_mm: tuple[float, float]
    figures: tuple[Disc | Polygon | Text, ...]
    bars_mm: tuple[float, float]


def drawing_room_mm(paper: str) -> tuple[float, float]:
    """Width and height that a drawing may take of a paper, upright."""
    width, height = PAPER_SIZES_MM[paper] - _around_mm()
    return float(width), float(height)


def _around_mm() -> Float[np.ndarray, "2"]:
    """What margins, bars and text take."""
    return 2 * _MARGIN_MM + np.array([2 * _BAR_GAP_MM, _BAR_GAP_MM + _TEXT_ROOM_MM])


def lay_out(pattern: AbstractTarget, paper: str = "a4") -> Page:
    """The sheet or board in true scale on a page, with a scale bar on both axes.

    paper : one of `PAPER_SIZES_MM`; the page is turned if the sheet only fits lying.

    Raises
    ------
    InputError : an unknown paper, or a sheet too large for it.
    """
    figures, low, high = drawing(pattern)
    return _page(pattern, paper, figures, low, high)


def drawing(
    pattern: AbstractTarget,
) -> tuple[list[Disc | Polygon | Text], Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Figures in the pattern's own mm, and the lower left and upper right corner of the ink."""
    if isinstance(pattern, Pattern):
        return _sheet_figures(pattern), *_box(pattern)
    ink = ink_polygons(pattern)
    every = np.concatenate(ink)
    return [Polygon(corners, True) for corners in ink], every.min(axis=0), every.max(axis=0)


def drawing_size_mm(pattern: AbstractTarget) -> tuple[float, float]:
    """Width and height of the ink, from outer edge to outer edge."""
    _, low, high = drawing(pattern)
    return _pair(high - low)


def _page(
    pattern: AbstractTarget,
    paper: str,
    figures: Sequence[Disc | Polygon | Text],
    low: Float[np.ndarray, "2"],
    high: Float[np.ndarray, "2"],
) -> Page:
    """The drawing, which fills the rectangle from `low` to `high`, on a page."""
    if paper.lower() not in PAPER_SIZES_MM:
        raise InputError(
            f"The paper {paper!r} is unknown; give one of {', '.join(PAPER_SIZES_MM)}."
        )
    needed = high - low + _around_mm()
    size = PAPER_SIZES_MM[paper.lower()]
    fitting = [page for page in (size, (size[1], size[0])) if np.all(needed <= page)]
    if not fitting:
        raise InputError(
            f"The pattern {pattern.name!r} needs {needed[0]:.0f} x {needed[1]:.0f} mm, more than"
            f" {paper} offers; take larger paper, or a smaller board."
        )
    page_mm = fitting[0]
    # The text stands below, so the sheet sits a little above the middle if room is short.
    free = page_mm[1] - (high - low)[1]
    below = max(0.5 * free, _MARGIN_MM + _BAR_GAP_MM + _TEXT_ROOM_MM)
    shift = np.array([0.0, -0.5 * page_mm[1] + below]) - np.array([0.5 * (low + high)[0], low[1]])
    bar_x, bar_y = (max(_BAR_STEP_MM * np.floor(side / _BAR_STEP_MM), 10.0) for side in high - low)
    figures = [_moved(figure, shift) for figure in figures]
    figures += _bars(low + shift, high + shift, bar_x, bar_y)
    places = "circles" if isinstance(pattern, Pattern) else "corners"
    words = (
        f"{pattern.name}   {len(pattern)} {places}   {paper.upper()}",
        "print at 100 % (actual size, no fit to page); then measure both bars",
    )
    foot = float((low + shift)[1]) - _BAR_GAP_MM
    figures += [
        Text((0.0, foot - 7.0 - 5.0 * line), text, False) for line, text in enumerate(words)
    ]
    return Page(pattern.name, page_mm, tuple(figures), (float(bar_x), float(bar_y)))


def _box(pattern: Pattern) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Corners of the rectangle that all ink lies in."""
    reach = pattern.radius_mm[:, None]
    low = (pattern.centres_mm - reach).min(axis=0)
    high = (pattern.centres_mm + reach).max(axis=0)
    if pattern.line_width_mm > 0:
        half = np.maximum(np.array(pattern.line_half_length_mm), 0.5 * pattern.line_width_mm)
        low, high = np.minimum(low, -half), np.maximum(high, half)
    return low, high


def _sheet_figures(pattern: Pattern) -> list[Disc | Polygon | Text]:
    circles: list[Disc | Polygon | Text] = []
    for centre, radius, inner in zip(
        pattern.centres_mm, pattern.radius_mm, pattern.inner_radius_mm, strict=True
    ):
        circles.append(Disc(_pair(centre), float(radius), True))
        if inner > 0:
            circles.append(Disc(_pair(centre), float(inner), False))
    lines: list[Disc | Polygon | Text] = [
        Polygon(corners, True) for corners in _line_corners(pattern)
    ]
    met = _circles_on_lines(pattern)
    if pattern.line_style == "through":
        return circles + lines
    if pattern.line_style == "white":
        cuts = [_cut(pattern, circle, axis) for circle, axis in met]
        return [*lines, *circles, *(Polygon(corners, False) for corners in cuts)]
    gaps = [
        Disc(_pair(pattern.centres_mm[k]), float(pattern.radius_mm[k]) + pattern.line_gap_mm, False)
        for k, _ in met
    ]
    return [*lines, *gaps, *circles]


def _line_corners(pattern: Pattern) -> list[Float[np.ndarray, "4 2"]]:
    if pattern.line_width_mm == 0:
        return []
    half_x, half_y = pattern.line_half_length_mm
    thin = 0.5 * pattern.line_width_mm
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return [sides * np.array([half_x, thin]), sides * np.array([thin, half_y])]


def _circles_on_lines(pattern: Pattern) -> list[tuple[int, int]]:
    """(circle, axis of the line) wherever a line comes within its gap of a circle."""
    if pattern.line_width_mm == 0:
        return []
    reach = pattern.radius_mm + pattern.line_gap_mm + 0.5 * pattern.line_width_mm
    return [
        (int(circle), axis)
        for axis in (0, 1)
        for circle in np.flatnonzero(np.abs(pattern.centres_mm[:, 1 - axis]) < reach)
    ]


def _cut(pattern: Pattern, circle: int, axis: int) -> Float[np.ndarray, "n 2"]:
    """The part of a circle that a line covers, as a polygon with finely divided arcs."""
    radius, thin = float(pattern.radius_mm[circle]), 0.5 * pattern.line_width_mm
    across = pattern.centres_mm[circle][1 - axis]
    low = np.arcsin(np.clip((-thin - across) / radius, -1.0, 1.0))
    high = np.arcsin(np.clip((thin - across) / radius, -1.0, 1.0))
    right = np.linspace(low, high, _ARC_POINTS)
    angle = np.concatenate([right, np.pi - right[::-1]])
    along_across = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return pattern.centres_mm[circle] + (along_across if axis == 0 else along_across[:, ::-1])


def _bars(
    low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], bar_x: float, bar_y: float
) -> list[Disc | Polygon | Text]:
    """The scale bars: ticks whose outer edges are the nominal length apart."""
    middle = 0.5 * (low + high)
    figures: list[Disc | Polygon | Text] = []
    for length, at, turned in (
        (bar_x, np.array([middle[0], low[1] - _BAR_GAP_MM]), False),
        (bar_y, np.array([low[0] - _BAR_GAP_MM, middle[1]]), True),
    ):
        half, thin = 0.5 * length, 0.5 * _BAR_WIDTH_MM
        rectangles = [(-half, half, -thin, thin)]
        rectangles += [(-half, -half + _BAR_WIDTH_MM, -_TICK_MM / 2, _TICK_MM / 2)]
        rectangles += [(half - _BAR_WIDTH_MM, half, -_TICK_MM / 2, _TICK_MM / 2)]
        for left, right, bottom, top in rectangles:
            corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
            figures.append(Polygon(at + (corners[:, ::-1] if turned else corners), True))
        words = f"{length:g} mm between the outer edges of the ticks"
        beside = np.array([-1.2, 0.0]) if turned else np.array([0.0, 1.2])
        figures.append(Text(_pair(at + beside), words, turned))
    return figures


def _moved(figure: Disc | Polygon | Text, shift: Float[np.ndarray, "2"]) -> Disc | Polygon | Text:
    if isinstance(figure, Polygon):
        return figure._replace(corners_mm=figure.corners_mm + shift)
    if isinstance(figure, Disc):
        return figure._replace(centre_mm=_pair(np.array(figure.centre_mm) + shift))
    return figure._replace(place_mm=_pair(np.array(figure.place_mm) + shift))


def _pair(point: np.ndarray) -> tuple[float, float]:
    return float(point[0]), float(point[1])
