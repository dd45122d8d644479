"""Pictures of the sheet by ray casting, independent of every model that is fitted to them."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from trinoc.geometry import Camera
from trinoc.synth.canvas import make_canvas, paint
from trinoc.synth.layers import Layer, Paint
from trinoc.synth.sensor import blur_and_integrate, blur_reach_px, expose
from trinoc.synth.shapes import ConvexPolygon, Disc, Intersection


@runtime_checkable
class PrintedSheet(Protocol):
    """Circles and crossed lines in mm on Z = 0; the fields mean what `trinoc.Pattern`'s do."""

    centres_mm: Float[np.ndarray, "n 2"]
    radius_mm: Float[np.ndarray, "n"]
    inner_radius_mm: Float[np.ndarray, "n"]
    line_width_mm: float
    line_half_length_mm: tuple[float, float]
    line_style: str
    line_gap_mm: float


def render_sheet(
    pattern: PrintedSheet,
    camera: Camera,
    *,
    paper: float = 230.0,
    ink: float = 25.0,
    blur_px: float = 0.7,
    noise_sigma: float = 0.0,
    supersampling: int = 8,
    below: tuple[Layer, ...] = (),
    above: tuple[Layer, ...] = (),
    seed: int = 0,
    dtype: str = "uint8",
) -> np.ndarray:
    """The (h, w) picture that a camera takes of a sheet, in grey levels from 0 to 255.

    A pixel that an edge may cross is divided into `supersampling` squared cells, two squared
    at least; a ray through the centre of each, lens distortion included, meets Z = 0, and the
    cells that the edge cuts are shared out along it. Paper reaches to the horizon unless a
    layer of `below`, painted before the pattern, says otherwise; `above` is painted after it:
    light, shade, things that cover the sheet (see `trinoc.synth.disturbances`). `blur_px` is
    the sigma of the lens's Gaussian, the pixel's box apart; `noise_sigma` is drawn by `seed`.
    For `dtype` see `trinoc.synth.sensor.expose`.
    """
    margin = blur_reach_px(blur_px)
    layers = (*below, *sheet_layers(pattern, paper=paper, ink=ink), *above)
    canvas = make_canvas(camera, layers, supersampling=supersampling, margin_px=margin)
    centre_grey, cell_grey = paint(canvas, layers, paper)
    grey = blur_and_integrate(
        centre_grey, cell_grey, canvas.divided, blur_px=blur_px, margin_px=margin
    )
    return expose(grey, noise_sigma=noise_sigma, seed=seed, dtype=dtype)


def sheet_layers(pattern: PrintedSheet, *, paper: float, ink: float) -> tuple[Layer, ...]:
    """The printed sheet as layers of paint, lowest first."""
    discs = [
        Disc(centre, float(radius))
        for centre, radius in zip(pattern.centres_mm, pattern.radius_mm, strict=True)
    ]
    circles = [Paint(disc, ink) for disc in discs] + [
        Paint(Disc(disc.centre_mm, float(inner)), paper)
        for disc, inner in zip(discs, pattern.inner_radius_mm, strict=True)
        if inner > 0
    ]
    lines = _lines(pattern)
    inked = [Paint(line, ink) for line in lines]
    if pattern.line_style == "through":
        return (*circles, *inked)
    if pattern.line_style == "white":
        crossed = [(line, disc) for line in lines for disc in discs if _meet(pattern, disc)]
        white = [Paint(Intersection(line, disc), paper) for line, disc in crossed]
        return (*inked, *circles, *white)
    gaps = [
        Paint(Disc(disc.centre_mm, disc.radius_mm + pattern.line_gap_mm), paper)
        for disc in discs
        if _meet(pattern, disc)
    ]
    return (*inked, *gaps, *circles)


def _lines(pattern: PrintedSheet) -> list[ConvexPolygon]:
    if not pattern.line_width_mm > 0:
        return []
    along_x, along_y = (2 * half for half in pattern.line_half_length_mm)
    width = pattern.line_width_mm
    return [
        ConvexPolygon.rectangle(np.zeros(2), (along_x, width)),
        ConvexPolygon.rectangle(np.zeros(2), (width, along_y)),
    ]


def _meet(pattern: PrintedSheet, disc: Disc) -> bool:
    """Whether a line comes within the gap of a circle."""
    reach = disc.radius_mm + max(pattern.line_gap_mm, 0.0) + pattern.line_width_mm / 2
    return bool((np.abs(disc.centre_mm) < reach).any())
