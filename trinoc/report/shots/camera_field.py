"""Where in each camera's field the board was seen, and where the fit misses it in one direction."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.calib import RigFromShots
from trinoc.report.numbers import percent, plain, round_scale, signed, with_decimals
from trinoc.report.pictures import PagePicture

# Parts of the picture, along each side, over which residuals are averaged.
PARTS = 8
# Fewer places in a part say nothing of its mean.
_FEWEST = 5
# The longest arrow, as a share of a part's width.
_REACH = 0.9


class MeanResidual(NamedTuple):
    """Of one part of the picture: its middle, the tip of its arrow, and what it means."""

    u: float
    v: float
    tip: tuple[float, float]
    words: str


class CameraField(NamedTuple):
    """One camera over all its shots.

    Fields
    ------
    picture : its size alone.
    places_px : (n, 2) all places that took part.
    outline_px : (k, 2) what holds them; `share` its area over the picture's.
    means : residuals averaged over parts of the picture, and `mean_rms_px` their length.
    over_chance : that length over what the scatter within the parts would leave; near 1 where
        nothing depends on the place. NaN where there are too few.
    magnification, key_px : of the arrows, one for all cameras.
    """

    name: str
    picture: PagePicture
    places_px: Float[np.ndarray, "n 2"]
    outline_px: Float[np.ndarray, "k 2"]
    share: float
    caption: str
    means: tuple[MeanResidual, ...]
    mean_rms_px: float
    over_chance: float
    magnification: str
    key_px: str
    key_length: float


class _Averages(NamedTuple):
    """Over the parts with places enough; `over_chance` as in `CameraField`."""

    middle_px: Float[np.ndarray, "n 2"]
    mean_px: Float[np.ndarray, "n 2"]
    count: Float[np.ndarray, "n"]
    over_chance: float


def fields_of_cameras(result: RigFromShots) -> tuple[CameraField, ...]:
    """A field for each camera that saw the board in some shot."""
    seen = [(number, *_all_places(result, number)) for number in range(len(result.cameras))]
    seen = [(number, places, errors) for number, places, errors in seen if len(places)]
    sizes = {number: _size_px(result, number) for number, _, _ in seen}
    averages = {number: _averages(sizes[number], *rest) for number, *rest in seen}
    longest = max(
        (
            float(np.linalg.norm(of.mean_px, axis=1).max()) / (sizes[number][0] / PARTS)
            for number, of in averages.items()
            if len(of.count)
        ),
        default=0.0,
    )
    magnification = round_scale(_REACH / longest) if longest > 1e-9 else 1.0
    return tuple(
        _field(result.cameras[k], sizes[k], places, averages[k], magnification)
        for k, places, _ in seen
    )


def _all_places(
    result: RigFromShots, camera: int
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """(places, residuals) of all its pictures."""
    places, errors = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for view, residuals in zip(result.views, result.residuals_px, strict=True):
        if view.camera == camera:
            shown = view.detection.centres_px if view.shown is None else view.shown.uv_px
            places.append(np.asarray(shown)[view.kept])
            errors.append(residuals[view.kept])
    return np.concatenate(places), np.concatenate(errors)


def _size_px(result: RigFromShots, camera: int) -> tuple[int, int]:
    return next(v.detection.image_size_px for v in result.views if v.camera == camera)


def _averages(
    size_px: tuple[int, int], places: Float[np.ndarray, "n 2"], errors: Float[np.ndarray, "n 2"]
) -> _Averages:
    part = np.array(size_px) / PARTS
    column, row = np.clip(((places + 0.5) // part).astype(int), 0, PARTS - 1).T
    key = row * PARTS + column
    count = np.bincount(key, minlength=PARTS**2)
    sums = [np.bincount(key, axis, minlength=PARTS**2) for axis in errors.T]
    said = count >= _FEWEST
    grid = np.stack(np.meshgrid(np.arange(PARTS), np.arange(PARTS)), axis=-1).reshape(-1, 2)
    mean = np.stack(sums, axis=1) / np.maximum(count, 1)[:, None]
    within = ((errors - mean[key])[said[key]] ** 2).sum() / max(2 * (count[said] - 1).sum(), 1)
    between = (count[:, None] * mean**2)[said]
    over_chance = float(np.sqrt(between.mean() / within)) if within > 0 else float("nan")
    middle = (grid[said] + 0.5) * part - 0.5
    return _Averages(middle, mean[said], count[said].astype(float), over_chance)


def _field(
    name: str,
    size_px: tuple[int, int],
    places: Float[np.ndarray, "n 2"],
    averages: _Averages,
    magnification: float,
) -> CameraField:
    outline = np.zeros((0, 2))
    if len(places) >= 3:
        outline = cv2.convexHull(places.astype(np.float32))[:, 0].astype(np.float64)
    share = float(cv2.contourArea(outline.astype(np.float32))) / (size_px[0] * size_px[1])
    lengths = np.linalg.norm(averages.mean_px, axis=1)
    key_px = round_scale(0.7 * size_px[0] / PARTS / magnification)
    means = tuple(
        MeanResidual(
            float(u),
            float(v),
            (float(u + magnification * du), float(v + magnification * dv)),
            f"mean residual ({signed(du, 4)}, {signed(dv, 4)}) px of {n:.0f} places",
        )
        for (u, v), (du, dv), n in zip(*averages[:3], strict=True)
    )
    return CameraField(
        name,
        PagePicture(name, *size_px, ""),
        places,
        outline,
        share,
        f"{percent(share)} of the picture, {len(places):,} places",
        means,
        float(np.sqrt(np.mean(lengths**2))) if len(lengths) else float("nan"),
        averages.over_chance,
        plain(magnification),
        plain(key_px),
        key_px * magnification,
    )


def caption_of_means(field: CameraField) -> str:
    """How long the mean residuals are, and beside chance."""
    return (
        f"{with_decimals(field.mean_rms_px, 3)} px rms, {with_decimals(field.over_chance, 1)} times"
        " what chance would leave"
    )
