"""Page layout of a calibration sheet or board, in mm, and its drawing as SVG and PDF."""

import io
import os
from typing import NamedTuple
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float

from trinoc.calib.targets.abstract_target import AbstractBoard, Disc, Polygon
from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write, write_text

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


class Text(NamedTuple):
    """A line of text on a page.

    Attributes
    ----------
    place_mm : (2,)
        Middle of the baseline.
    text : str
        The text.
    is_upright : bool
        True if the text runs upward.
    """

    place_mm: tuple[float, float]
    text: str
    is_upright: bool


class PatternPage(NamedTuple):
    """A page with the drawing of a board. Coordinates are mm from the page centre, X right, Y up.

    Attributes
    ----------
    title : str
        Title of the page.
    size_mm : (width, height)
        Size of the page.
    figures : tuple of Disc, Polygon or Text
        Figures in the order of painting.
    bars_mm : (2,)
        Nominal lengths of the two scale bars, along X and along Y.
    """

    title: str
    size_mm: tuple[float, float]
    figures: tuple[Disc | Polygon | Text, ...]
    bars_mm: tuple[float, float]


def drawing_room_mm(paper: str) -> tuple[float, float]:
    """Largest (width, height), mm, of a drawing on a paper size in portrait format."""
    width, height = PAPER_SIZES_MM[paper] - _around_mm()
    return float(width), float(height)


def _around_mm() -> Float[np.ndarray, "2"]:
    """(width, height), mm, that margins, scale bars and text need in addition to the drawing."""
    return 2 * _MARGIN_MM + np.array([2 * _BAR_GAP_MM, _BAR_GAP_MM + _TEXT_ROOM_MM])


def lay_out(board: AbstractBoard, paper: str = "a4") -> PatternPage:
    """Place the true-scale drawing of a board on a page, with scale bars along X and Y.

    Parameters
    ----------
    board : AbstractBoard
        Sheet of circles or board.
    paper : str
        A key of `PAPER_SIZES_MM`. Landscape format is used if the drawing does not fit in portrait.

    Returns
    -------
    PatternPage

    Raises
    ------
    InputError
        If the paper size is unknown, or too small for the drawing.
    """
    if paper.lower() not in PAPER_SIZES_MM:
        raise InputError(
            f"The paper {paper!r} is unknown; give one of {', '.join(PAPER_SIZES_MM)}."
        )
    low, high = drawing_box_mm(board)
    needed = high - low + _around_mm()
    size = PAPER_SIZES_MM[paper.lower()]
    fitting = [page for page in (size, (size[1], size[0])) if np.all(needed <= page)]
    if not fitting:
        raise InputError(
            f"The pattern {board.name!r} needs {needed[0]:.0f} x {needed[1]:.0f} mm, more than"
            f" {paper} offers; take larger paper, or a smaller board."
        )
    page_mm = fitting[0]
    # The text stands below, so the sheet sits a little above the middle if room is short.
    free = page_mm[1] - (high - low)[1]
    below = max(0.5 * free, _MARGIN_MM + _BAR_GAP_MM + _TEXT_ROOM_MM)
    shift = np.array([0.0, -0.5 * page_mm[1] + below]) - np.array([0.5 * (low + high)[0], low[1]])
    bar_x, bar_y = (max(_BAR_STEP_MM * np.floor(side / _BAR_STEP_MM), 10.0) for side in high - low)
    # Control characters, which XML does not have.
    title = "".join(letter if letter.isprintable() else " " for letter in board.name)
    lines = (
        f"{title}   {len(board)} {board.point_kind}   {paper.upper()}",
        "print at 100 % (actual size, no fit to page); then measure both bars",
    )
    foot = float((low + shift)[1]) - _BAR_GAP_MM
    figures = (
        *(_shift_figure(figure, shift) for figure in board.drawing()),
        *_scale_bars(low + shift, high + shift, bar_x, bar_y),
        *(Text((0.0, foot - 7.0 - 5.0 * line), text, False) for line, text in enumerate(lines)),
    )
    return PatternPage(title, page_mm, figures, (float(bar_x), float(bar_y)))


def drawing_box_mm(board: AbstractBoard) -> Float[np.ndarray, "2 2"]:
    """Bounding box of the ink of a board: lower left and upper right corner, (2, 2).

    Raise `InputError` if the argument is not a board.
    """
    if not isinstance(board, AbstractBoard):
        raise InputError(f"A {type(board).__name__} cannot be drawn: give a board or a Pattern.")
    corners = np.concatenate(
        [
            figure.corners_mm
            if isinstance(figure, Polygon)
            else figure.centre_mm + figure.radius_mm * np.array([[-1.0, -1.0], [1.0, 1.0]])
            for figure in board.drawing()
            if figure.is_ink
        ]
    )
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def drawing_size_mm(board: AbstractBoard) -> tuple[float, float]:
    """(width, height), mm, of the bounding box of a board's ink."""
    low, high = drawing_box_mm(board)
    return _pair(high - low)


def _scale_bars(
    low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], bar_x: float, bar_y: float
) -> list[Disc | Polygon | Text]:
    """Figures of both scale bars: bars with a tick at each end, and labels.

    The outer edges of the ticks are one bar length apart. `low` and `high` are corners of the
    drawing; `bar_x` and `bar_y` are the bar lengths. All are in mm.
    """
    middle = 0.5 * (low + high)
    figures: list[Disc | Polygon | Text] = []
    for length, position, is_vertical in (
        (bar_x, np.array([middle[0], low[1] - _BAR_GAP_MM]), False),
        (bar_y, np.array([low[0] - _BAR_GAP_MM, middle[1]]), True),
    ):
        half, half_width = 0.5 * length, 0.5 * _BAR_WIDTH_MM
        rectangles = [(-half, half, -half_width, half_width)]
        rectangles += [(-half, -half + _BAR_WIDTH_MM, -_TICK_MM / 2, _TICK_MM / 2)]
        rectangles += [(half - _BAR_WIDTH_MM, half, -_TICK_MM / 2, _TICK_MM / 2)]
        for left, right, bottom, top in rectangles:
            corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
            figures.append(Polygon(position + (corners[:, ::-1] if is_vertical else corners), True))
        label = f"{length:g} mm between the outer edges of the ticks"
        label_offset = np.array([-1.2, 0.0]) if is_vertical else np.array([0.0, 1.2])
        figures.append(Text(_pair(position + label_offset), label, is_vertical))
    return figures


def _shift_figure(figure: Disc | Polygon, shift: Float[np.ndarray, "2"]) -> Disc | Polygon:
    if isinstance(figure, Polygon):
        return figure._replace(corners_mm=figure.corners_mm + shift)
    return figure._replace(centre_mm=_pair(np.array(figure.centre_mm) + shift))


def _pair(point: np.ndarray) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def save_pattern_svg(
    pattern: AbstractBoard, path: str | os.PathLike[str], *, paper: str = "a4"
) -> None:
    """Write the true-scale drawing of a board as SVG.

    Parameters
    ----------
    pattern : AbstractBoard
        Sheet of circles or board.
    path : path
        File to write.
    paper : str
        Paper size, a key of `PAPER_SIZES_MM`.

    Raises
    ------
    InputError
        If the drawing does not fit on the paper.
    """
    write_text(path, pattern_svg(lay_out(pattern, paper)))


def pattern_svg(page: PatternPage) -> str:
    """SVG text of a page. One user unit is 1 mm."""
    width, height = page.size_mm
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm"'
        f' viewBox="0 0 {width:g} {height:g}">',
        f"<title>{escape(page.title)}</title>",
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
    ]
    for figure in page.figures:
        if isinstance(figure, Disc):
            x, y = _from_top_left(figure.centre_mm, page)
            fill = _fill(figure.is_ink)
            lines.append(f'<circle cx="{x}" cy="{y}" r="{_number(figure.radius_mm)}" {fill}/>')
        elif isinstance(figure, Polygon):
            corners = " ".join(",".join(_from_top_left(c, page)) for c in figure.corners_mm)
            lines.append(f'<polygon points="{corners}" {_fill(figure.is_ink)}/>')
        else:
            x, y = _from_top_left(figure.place_mm, page)
            turn = f' transform="rotate(-90 {x} {y})"' if figure.is_upright else ""
            lines.append(
                f'<text x="{x}" y="{y}" font-family="sans-serif" font-size="{LETTER_MM:g}"'
                f' text-anchor="middle"{turn}>{escape(figure.text)}</text>'
            )
    return "\n".join([*lines, "</svg>", ""])


def _from_top_left(place_mm, page: PatternPage) -> tuple[str, str]:
    """Convert a point to SVG coordinates, from the top left corner of the page, y down, as text."""
    width, height = page.size_mm
    return _number(0.5 * width + place_mm[0]), _number(0.5 * height - place_mm[1])


def _fill(is_ink: bool) -> str:
    return 'fill="black"' if is_ink else 'fill="white"'


def _number(value: float) -> str:
    return f"{float(value):.5f}".rstrip("0").rstrip(".")


_POINTS_PER_MM = 72.0 / 25.4


def save_pattern_pdf(
    pattern: AbstractBoard, path: str | os.PathLike[str], *, paper: str = "a4"
) -> None:
    """Write the true-scale drawing of a board as PDF.

    Parameters
    ----------
    pattern : AbstractBoard
        Sheet of circles or board.
    path : path
        File to write.
    paper : str
        Paper size, a key of `PAPER_SIZES_MM`.

    Raises
    ------
    InputError
        If the drawing does not fit on the paper, or reportlab is not installed.

    Notes
    -----
    The page box has exactly the size of the paper. The file asks viewers not to scale it in print.
    """
    content = pattern_pdf(lay_out(pattern, paper))
    with atomic_write(path) as file:
        file.write(content)


def pattern_pdf(page: PatternPage) -> bytes:
    """Content of the PDF file of a page; equal pages give equal content."""
    try:
        from reportlab.pdfgen.canvas import Canvas
    except ImportError as error:
        raise InputError(
            "Drawing a PDF needs reportlab; install it with pip install 'trinoc[print]', or"
            " write an SVG."
        ) from error
    width, height = page.size_mm
    buffer = io.BytesIO()
    canvas = Canvas(
        buffer,
        pagesize=(width * _POINTS_PER_MM, height * _POINTS_PER_MM),
        invariant=1,
    )
    canvas.setTitle(page.title)
    canvas.setViewerPreference("PrintScaling", "None")
    canvas.scale(_POINTS_PER_MM, _POINTS_PER_MM)
    canvas.translate(0.5 * width, 0.5 * height)
    for figure in page.figures:
        if isinstance(figure, Disc):
            canvas.setFillGray(0.0 if figure.is_ink else 1.0)
            canvas.circle(*figure.centre_mm, figure.radius_mm, stroke=0, fill=1)
        elif isinstance(figure, Polygon):
            canvas.setFillGray(0.0 if figure.is_ink else 1.0)
            outline = canvas.beginPath()
            outline.moveTo(*figure.corners_mm[0])
            for corner in figure.corners_mm[1:]:
                outline.lineTo(*corner)
            outline.close()
            canvas.drawPath(outline, stroke=0, fill=1)
        else:
            canvas.saveState()
            canvas.setFillGray(0.0)
            canvas.setFont("Helvetica", LETTER_MM)
            canvas.translate(*figure.place_mm)
            canvas.rotate(90 if figure.is_upright else 0)
            canvas.drawCentredString(0, 0, figure.text)
            canvas.restoreState()
    canvas.showPage()
    canvas.save()
    return buffer.getvalue()
