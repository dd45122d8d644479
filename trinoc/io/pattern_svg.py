"""A sheet as an SVG whose units are millimetres."""

import os
from xml.sax.saxutils import escape

from trinoc.calib.targets.abstract_target import AbstractBoard, Disc, Polygon
from trinoc.io.atomic import write_text
from trinoc.io.pattern_page import LETTER_MM, PatternPage, lay_out


def save_pattern_svg(
    pattern: AbstractBoard, path: str | os.PathLike[str], *, paper: str = "a4"
) -> None:
    """Draw the sheet in true scale. Raises InputError where it does not fit the paper."""
    write_text(path, pattern_svg(lay_out(pattern, paper)))


def pattern_svg(page: PatternPage) -> str:
    """The SVG text of a page; one user unit is one millimetre."""
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
                f' text-anchor="middle"{turn}>{escape(figure.words)}</text>'
            )
    return "\n".join([*lines, "</svg>", ""])


def _from_top_left(place_mm, page: PatternPage) -> tuple[str, str]:
    """SVG counts from the top left, downward."""
    width, height = page.size_mm
    return _number(0.5 * width + place_mm[0]), _number(0.5 * height - place_mm[1])


def _fill(is_ink: bool) -> str:
    return 'fill="black"' if is_ink else 'fill="white"'


def _number(value: float) -> str:
    return f"{float(value):.5f}".rstrip("0").rstrip(".")
