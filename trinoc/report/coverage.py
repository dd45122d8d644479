"""Coverage of each image by circles or boards, and mean residuals over parts of an image."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.report.numbers import percent, with_decimals, with_sign
from trinoc.report.pictures import Arrows, PagePicture

# Parts of the picture, along each side, over which residuals are averaged.
PARTS = 8
# A part with fewer points has no mean.
_FEWEST = 5
# The longest arrow, as a share of a part's width.
_REACH = 0.9


class Coverage(NamedTuple):
    """Part of one camera's image in which board points were used.

    Attributes
    ----------
    name : str
        Name of the camera.
    picture : PagePicture
        The image.
    places_px : (n, 2)
        Used circles or corners.
    outline_px : (k, 2)
        Their convex hull; empty for fewer than three points.
    share : float
        Area of the hull over the area of the image.
    caption : str
        Caption of the figure.
    """

    name: str
    picture: PagePicture
    places_px: Float[np.ndarray, "n 2"]
    outline_px: Float[np.ndarray, "k 2"]
    share: float
    caption: str


class MeanResidual(NamedTuple):
    """Mean residual in one cell of an image.

    Attributes
    ----------
    u, v : float
        Middle of the cell, px.
    tip : (u, v)
        Tip of the arrow that shows the residual, px.
    description : str
        Text that appears when the reader points at the arrow.
    """

    u: float
    v: float
    tip: tuple[float, float]
    description: str


class MeanResiduals(NamedTuple):
    """Mean residuals of one camera in the cells of its image.

    Attributes
    ----------
    name : str
        Name of the camera.
    picture : PagePicture
        Size of the image.
    means : tuple of MeanResidual
        Cells with enough points.
    rms_px : float
        Root mean square length of the mean residuals.
    over_chance : float
        `rms_px` divided by the value that random residuals with the scatter inside the cells would
        give. It is near 1 if residuals do not depend on the position in the image, and NaN with too
        few points.
    caption : str
        Caption of the figure.
    """

    name: str
    picture: PagePicture
    means: tuple[MeanResidual, ...]
    rms_px: float
    over_chance: float
    caption: str


class CameraPlaces(NamedTuple):
    """Used board points of one camera in all shots, and their residuals.

    Attributes
    ----------
    picture : PagePicture
        Size of the image.
    places_px : (n, 2)
        Detected points.
    residuals_px : (n, 2)
        Residuals, predicted minus observed.
    """

    picture: PagePicture
    places_px: Float[np.ndarray, "n 2"]
    residuals_px: Float[np.ndarray, "n 2"]


def coverage_by_circles(
    result: CalibrationResult, pictures: dict[str, PagePicture]
) -> tuple[Coverage, ...]:
    """Coverage of each camera's image by the circles of the sheet."""
    count = len(result.pattern)
    used = {name: np.asarray(fit.used) for name, fit in result.fits.items()}
    return tuple(
        _coverage(
            name,
            pictures[name],
            np.asarray(fit.detection.centres_px)[used[name]],
            f"{used[name].sum()} of {count} circles",
        )
        for name, fit in result.fits.items()
    )


def coverage_by_boards(points: dict[str, CameraPlaces]) -> tuple[Coverage, ...]:
    """Coverage of each camera's image by the board points of all shots. points : by camera."""
    return tuple(
        _coverage(name, places.picture, places.places_px, f"{len(places.places_px):,} places")
        for name, places in points.items()
    )


def _coverage(
    name: str, picture: PagePicture, places_px: Float[np.ndarray, "n 2"], counted: str
) -> Coverage:
    outline = np.zeros((0, 2))
    if len(places_px) >= 3:
        outline = cv2.convexHull(places_px.astype(np.float32))[:, 0].astype(np.float64)
    area = float(cv2.contourArea(outline.astype(np.float32)))
    share = area / (picture.width_px * picture.height_px)
    caption = f"{percent(share)} of the picture, {counted}"
    return Coverage(name, picture, places_px, outline, share, caption)


def places_seen(result: CalibrationResult) -> dict[str, CameraPlaces]:
    """Used board points and residuals of each camera that detected a board."""
    points = {}
    for number, name in enumerate(result.cameras):
        observations = [
            (view, residuals[view.rows_used])
            for view, residuals in zip(result.views, result.residuals_px, strict=True)
            if view.camera == number
        ]
        if sum(len(residuals) for _, residuals in observations):
            uv_px = [
                np.asarray(
                    v.detection.centres_px
                    if v.grey_level_points is None
                    else v.grey_level_points.uv_px
                )[v.rows_used]
                for v, _ in observations
            ]
            picture = PagePicture(name, *observations[0][0].detection.image_size_px, "")
            errors = np.concatenate([residuals for _, residuals in observations])
            points[name] = CameraPlaces(picture, np.concatenate(uv_px), errors)
    return points


def mean_residuals(points: dict[str, CameraPlaces]) -> tuple[tuple[MeanResiduals, ...], Arrows]:
    """Mean residuals in the cells of each camera's image, and the common scale of their arrows.

    points : used board points and residuals by camera.
    """
    averages = {name: _averages(places) for name, places in points.items()}
    arrows = Arrows.reaching(
        [
            (
                float(np.linalg.norm(average.mean_px, axis=1).max()),
                _REACH * points[name].picture.width_px / PARTS,
            )
            for name, average in averages.items()
            if len(average.mean_px)
        ]
    )
    return tuple(
        _mean_residuals(name, places.picture, averages[name], arrows)
        for name, places in points.items()
    ), arrows


class _Averages(NamedTuple):
    """Mean residuals of one camera in the n cells of its image that have enough points.

    middle_px : middles of the cells.
    mean_px : mean residuals.
    count : numbers of points.
    over_chance : as in `MeanResiduals`.
    """

    middle_px: Float[np.ndarray, "n 2"]
    mean_px: Float[np.ndarray, "n 2"]
    count: Int[np.ndarray, "n"]
    over_chance: float


def _averages(points: CameraPlaces) -> _Averages:
    part = np.array([points.picture.width_px, points.picture.height_px]) / PARTS
    column, row = np.clip(((points.places_px + 0.5) // part).astype(int), 0, PARTS - 1).T
    key = row * PARTS + column
    count = np.bincount(key, minlength=PARTS**2)
    sums = [np.bincount(key, axis, minlength=PARTS**2) for axis in points.residuals_px.T]
    enough = count >= _FEWEST
    grid = np.stack(np.meshgrid(np.arange(PARTS), np.arange(PARTS)), axis=-1).reshape(-1, 2)
    mean = np.stack(sums, axis=1) / np.maximum(count, 1)[:, None]
    scatter = (points.residuals_px - mean[key])[enough[key]]
    within = (scatter**2).sum() / max(2 * (count[enough] - 1).sum(), 1)
    between = (count[:, None] * mean**2)[enough]
    over_chance = float(np.sqrt(between.mean() / within)) if within > 0 else float("nan")
    return _Averages((grid[enough] + 0.5) * part - 0.5, mean[enough], count[enough], over_chance)


def _mean_residuals(
    name: str, picture: PagePicture, of: _Averages, arrows: Arrows
) -> MeanResiduals:
    lengths = np.linalg.norm(of.mean_px, axis=1)
    rms = float(np.sqrt(np.mean(lengths**2))) if len(lengths) else float("nan")
    return MeanResiduals(
        name,
        picture,
        tuple(
            MeanResidual(
                float(u),
                float(v),
                arrows.tip((u, v), (du, dv)),
                f"mean residual ({with_sign(du, 4)}, {with_sign(dv, 4)}) px of {n:.0f} places",
            )
            for (u, v), (du, dv), n in zip(*of[:3], strict=True)
        ),
        rms,
        of.over_chance,
        f"{with_decimals(rms, 3)} px rms, {with_decimals(of.over_chance, 1)} times what chance "
        "would leave",
    )
