"""How much of each picture the circles or boards cover, and residuals over parts of a picture."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.report.numbers import percent, with_decimals, with_sign
from trinoc.report.pictures import Arrows, PagePicture

# Parts of the picture, along each side, over which residuals are averaged.
PARTS = 8
# Fewer places in a part say nothing of its mean.
_FEWEST = 5
# The longest arrow, as a share of a part's width.
_REACH = 0.9


class Coverage(NamedTuple):
    """A whole picture with the places that took part and the outline that holds them.

    `share` is the area of the outline over that of the picture.
    """

    name: str
    picture: PagePicture
    places_px: Float[np.ndarray, "n 2"]
    outline_px: Float[np.ndarray, "k 2"]
    share: float
    caption: str


class MeanResidual(NamedTuple):
    """Of one part of the picture: its middle, the tip of its arrow, and what it means."""

    u: float
    v: float
    tip: tuple[float, float]
    words: str


class MeanResiduals(NamedTuple):
    """One camera's, averaged over parts of its picture.

    Fields
    ------
    rms_px : the length of the means.
    over_chance : that length over what the scatter within the parts would leave; near 1 where
        nothing depends on the place. NaN where there are too few.
    """

    name: str
    picture: PagePicture
    means: tuple[MeanResidual, ...]
    rms_px: float
    over_chance: float
    caption: str


class CameraPlaces(NamedTuple):
    """All places of one camera over its shots that took part, and their residuals."""

    picture: PagePicture
    places_px: Float[np.ndarray, "n 2"]
    residuals_px: Float[np.ndarray, "n 2"]


def coverage_by_circles(
    result: CalibrationResult, pictures: dict[str, PagePicture]
) -> tuple[Coverage, ...]:
    """For each camera in whose picture the sheet was found."""
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


def coverage_by_boards(seen: dict[str, CameraPlaces]) -> tuple[Coverage, ...]:
    """For each camera, over all shots."""
    return tuple(
        _coverage(name, own.picture, own.places_px, f"{len(own.places_px):,} places")
        for name, own in seen.items()
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
    """By camera; those that saw no board are left out."""
    found = {}
    for number, name in enumerate(result.cameras):
        own = [
            (view, residuals[view.rows_used])
            for view, residuals in zip(result.views, result.residuals_px, strict=True)
            if view.camera == number
        ]
        if sum(len(residuals) for _, residuals in own):
            shown = [
                v.detection.centres_px if v.grey_level_points is None else v.grey_level_points.uv_px
                for v, _ in own
            ]
            places = [np.asarray(uv)[v.rows_used] for uv, (v, _) in zip(shown, own, strict=True)]
            picture = PagePicture(name, *own[0][0].detection.image_size_px, "")
            errors = np.concatenate([residuals for _, residuals in own])
            found[name] = CameraPlaces(picture, np.concatenate(places), errors)
    return found


def mean_residuals(seen: dict[str, CameraPlaces]) -> tuple[tuple[MeanResiduals, ...], Arrows]:
    """Of each camera, and the scale of the arrows, one for all."""
    averages = {name: _averages(own) for name, own in seen.items()}
    arrows = Arrows.reaching(
        [
            (
                float(np.linalg.norm(of.mean_px, axis=1).max()),
                _REACH * seen[name].picture.width_px / PARTS,
            )
            for name, of in averages.items()
            if len(of.mean_px)
        ]
    )
    return tuple(
        _mean_residuals(name, own.picture, averages[name], arrows) for name, own in seen.items()
    ), arrows


class _Averages(NamedTuple):
    """Middles, means and counts of the parts with places enough; `over_chance` of all."""

    middle_px: Float[np.ndarray, "n 2"]
    mean_px: Float[np.ndarray, "n 2"]
    count: Int[np.ndarray, "n"]
    over_chance: float


def _averages(seen: CameraPlaces) -> _Averages:
    part = np.array([seen.picture.width_px, seen.picture.height_px]) / PARTS
    column, row = np.clip(((seen.places_px + 0.5) // part).astype(int), 0, PARTS - 1).T
    key = row * PARTS + column
    count = np.bincount(key, minlength=PARTS**2)
    sums = [np.bincount(key, axis, minlength=PARTS**2) for axis in seen.residuals_px.T]
    said = count >= _FEWEST
    grid = np.stack(np.meshgrid(np.arange(PARTS), np.arange(PARTS)), axis=-1).reshape(-1, 2)
    mean = np.stack(sums, axis=1) / np.maximum(count, 1)[:, None]
    scatter = (seen.residuals_px - mean[key])[said[key]]
    within = (scatter**2).sum() / max(2 * (count[said] - 1).sum(), 1)
    between = (count[:, None] * mean**2)[said]
    over_chance = float(np.sqrt(between.mean() / within)) if within > 0 else float("nan")
    return _Averages((grid[said] + 0.5) * part - 0.5, mean[said], count[said], over_chance)


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
