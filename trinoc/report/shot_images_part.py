"""The residuals of each shot on its image: a contact sheet, the shots with the largest first."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.starts.pictures import Pictures, deliver, name_pictures
from trinoc.calib.starts.placing import original_shot_name
from trinoc.report.numbers import with_decimals
from trinoc.report.pictures import Arrows, PagePicture, page_picture

# Shots of one camera that the page shows, and the size and quality of their images.
MOST_SHOTS = 12
_SIDE_PX, _QUALITY = 480, 72
# This share of the residuals is drawn no longer than this share of the image's width.
_SHARE, _REACH = 0.9, 0.04
# Longer residuals, as of wrong corners, are cut at this share.
_LONGEST = 0.2


class ShotImage(NamedTuple):
    """One image with the residuals of its corners or circles as SVG paths.

    Fields
    ------
    used, left_out : dots where they were found.
    residuals, residuals_left_out : lines from there, predicted minus observed, magnified.
    """

    name: str
    caption: str
    picture: PagePicture
    used: str
    left_out: str
    residuals: str
    residuals_left_out: str


class CameraShots(NamedTuple):
    """The figures of one camera; `words` says which of its shots they are."""

    name: str
    words: str
    figures: tuple[ShotImage, ...]


class ShotImagesPart(NamedTuple):
    """All cameras; residuals are drawn `times` as long."""

    cameras: tuple[CameraShots, ...]
    times: str
    any_left_out: bool

    @property
    def pictures(self) -> list[PagePicture]:
        """The images that the page has to hold."""
        figures = [figure for camera in self.cameras for figure in camera.figures]
        return [figure.picture for figure in figures if figure.picture.uri]


class _ShotResiduals(NamedTuple):
    """What one camera saw in one shot: its places, their residuals and which took part."""

    shot: int
    size_px: tuple[int, int]
    uv_px: Float[np.ndarray, "n 2"]
    residuals_px: Float[np.ndarray, "n 2"]
    used: Bool[np.ndarray, "n"]

    @property
    def rms_px(self) -> float:
        """Root mean square residual, px, over all corners or circles, used or left out."""
        return float(np.sqrt(np.mean(np.sum(self.residuals_px**2, axis=1))))


def shot_images_part(
    result: CalibrationResult, pictures: Mapping[str, Pictures] | None
) -> ShotImagesPart | None:
    """The contact sheet; None if no camera saw a board.

    pictures : as `calibrate_rig` takes them: arrays, detections or functions that return an array.
        Only those that are shown are read. Without one, the residuals are drawn on grey.
    """
    named = name_pictures(pictures or {})
    seen = {
        number: sorted(_list_shots(result, number), key=lambda own: -own.rms_px)
        for number in range(len(result.cameras))
    }
    arrows = _choose_scale([own for shots in seen.values() for own in shots[:MOST_SHOTS]])
    cameras = tuple(
        CameraShots(
            result.cameras[number],
            _say_choice(len(shots)),
            tuple(
                _shot_image(result, number, own, named.get(result.cameras[number], {}), arrows)
                for own in shots[:MOST_SHOTS]
            ),
        )
        for number, shots in seen.items()
        if shots
    )
    if not cameras:
        return None
    shown = [figure for camera in cameras for figure in camera.figures]
    return ShotImagesPart(cameras, arrows.said[0], any(figure.left_out for figure in shown))


def _say_choice(count: int) -> str:
    if count > MOST_SHOTS:
        return f"the {MOST_SHOTS} of {count} shots with the largest residuals, the largest first"
    return f"all {count} shots, the largest residuals first" if count > 1 else "its only shot"


def _list_shots(result: CalibrationResult, camera: int) -> list[_ShotResiduals]:
    """Each shot of a camera; several boards in it are one."""
    rows: dict[int, list[int]] = {}
    for row, view in enumerate(result.views):
        if view.camera == camera:
            rows.setdefault(view.shot, []).append(row)
    found = []
    for shot, own in rows.items():
        views = [result.views[row] for row in own]
        places = [
            np.asarray(
                v.detection.centres_px if v.grey_level_points is None else v.grey_level_points.uv_px
            )
            for v in views
        ]
        residuals = np.concatenate([result.residuals_px[row] for row in own])
        used = np.concatenate([view.rows_used for view in views])
        uv_px = np.concatenate(places)
        known = np.isfinite(residuals).all(axis=1) & np.isfinite(uv_px).all(axis=1)
        # Grey levels report pieces of lines beside the places; those without information are none.
        known &= used | np.concatenate(
            [np.full(v.row_count, v.grey_level_points is None) for v in views]
        )
        if known.any():
            size_px = views[0].detection.image_size_px
            found.append(_ShotResiduals(shot, size_px, uv_px[known], residuals[known], used[known]))
    return found


def _choose_scale(shots: list[_ShotResiduals]) -> Arrows:
    """One scale for all images, so that lengths compare across them."""
    shares = [np.linalg.norm(own.residuals_px[own.used], axis=1) / own.size_px[0] for own in shots]
    every = np.concatenate([np.zeros(0), *shares])
    return Arrows.reaching([(float(np.quantile(every, _SHARE)), _REACH)] if len(every) else [])


def _shot_image(
    result: CalibrationResult,
    camera: int,
    own: _ShotResiduals,
    pictures: Mapping[str, object],
    arrows: Arrows,
) -> ShotImage:
    name, shot = result.cameras[camera], result.shots[own.shot]
    image = deliver(pictures.get(original_shot_name(shot, name)))
    key = f"shot-{camera}-{own.shot}"
    array = None if image is None or isinstance(image, Detection) else np.asarray(image)
    picture = page_picture(key, array, own.size_px, longest_side_px=_SIDE_PX, quality=_QUALITY)
    lengths = np.linalg.norm(own.residuals_px, axis=1)
    longest = _LONGEST * own.size_px[0]
    stretch = np.minimum(arrows.times, longest / np.maximum(lengths, 1e-12))
    ends = own.uv_px + stretch[:, None] * own.residuals_px
    used, wrong = own.used, ~own.used
    return ShotImage(
        shot,
        _caption(own),
        picture._replace(width_px=own.size_px[0], height_px=own.size_px[1]),
        _dots(own.uv_px[used]),
        _dots(own.uv_px[wrong]),
        _lines(own.uv_px[used], ends[used]),
        _lines(own.uv_px[wrong], ends[wrong]),
    )


def _caption(own: _ShotResiduals) -> str:
    """How many took part, how far off they are, and how many were left out."""
    wrong = int((~own.used).sum())
    if wrong == len(own.used):
        return f"left out, {with_decimals(own.rms_px, 2)} px rms"
    rms_px = own._replace(residuals_px=own.residuals_px[own.used]).rms_px
    caption = f"{with_decimals(rms_px, 3)} px rms"
    return f"{caption}, {wrong} left out" if wrong else caption


def _dots(places_px: Float[np.ndarray, "n 2"]) -> str:
    """A path of points, to be drawn with round ends."""
    return "".join(f"M{u:.1f} {v:.1f}h0" for u, v in places_px)


def _lines(from_px: Float[np.ndarray, "n 2"], to_px: Float[np.ndarray, "n 2"]) -> str:
    """A path of lines, one for each place."""
    return "".join(
        f"M{u:.1f} {v:.1f}l{du:.1f} {dv:.1f}"
        for (u, v), (du, dv) in zip(from_px, to_px - from_px, strict=True)
    )
