"""A sheet as a PDF that viewers print in true scale; needs the extra `print`."""

import io
import os

from trinoc.calib.targets.abstract_target import AbstractBoard, Disc, Polygon
from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write
from trinoc.io.pattern_page import LETTER_MM, PatternPage, lay_out

_POINTS_PER_MM = 72.0 / 25.4


def save_pattern_pdf(
    pattern: AbstractBoard, path: str | os.PathLike[str], *, paper: str = "a4"
) -> None:
    """Draw the sheet in true scale.

    The page box is the paper's exactly, and viewers are told not to scale when printing.
    Raises InputError where the sheet does not fit the paper, or reportlab is not installed.
    """
    content = pattern_pdf(lay_out(pattern, paper))
    with atomic_write(path) as file:
        file.write(content)


def pattern_pdf(page: PatternPage) -> bytes:
    """The PDF file of a page, the same bytes for the same page."""
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
            canvas.drawCentredString(0, 0, figure.words)
            canvas.restoreState()
    canvas.showPage()
    canvas.save()
    return buffer.getvalue()
