"""Residuals of each shot on its image: a contact sheet, with the largest residuals first."""

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
    """One image of a shot with the residuals of its corners or circles.

    Attributes
    ----------
    name : str
        Name of the shot.
    caption : str
        Caption of the figure.
    picture : PagePicture
        The image.
    used, left_out : str
        SVG paths with a dot at each used and each excluded point.
    residuals, residuals_left_out : str
        SVG paths with the magnified residuals, predicted minus observed, at these points.
    """

    name: str
    caption: str
    picture: PagePicture
    used: str
    left_out: str
    residuals: str
    residuals_left_out: str


class CameraShots(NamedTuple):
    """Figures of the shots of one camera. `caption` states which shots they are."""

    name: str
    caption: str
    figures: tuple[ShotImage, ...]


class ShotImagesPart(NamedTuple):
    """Section of the report with the residuals of each shot on its image.

    Attributes
    ----------
    cameras : tuple of CameraShots
        Figures of each camera.
    times : str
        Magnification of the residuals, as text.
    any_left_out : bool
        True if a fit excluded a point.
    """

    cameras: tuple[CameraShots, ...]
    times: str
    any_left_out: bool

    @property
    def pictures(self) -> list[PagePicture]:
        """Images that the page contains."""
        figures = [figure for camera in self.cameras for figure in camera.figures]
        return [figure.picture for figure in figures if figure.picture.uri]


class _ShotResiduals(NamedTuple):
    """Detected points of one camera in one shot, their residuals, and whether each was used."""

    shot: int
    size_px: tuple[int, int]
    uv_px: Float[np.ndarray, "n 2"]
    residuals_px: Float[np.ndarray, "n 2"]
    used: Bool[np.ndarray, "n"]

    @property
    def rms_px(self) -> float:
        """Root mean square residual, px, of all points, used or excluded."""
        return float(np.sqrt(np.mean(np.sum(self.residuals_px**2, axis=1))))


def shot_images_part(
    result: CalibrationResult, pictures: Mapping[str, Pictures] | None
) -> ShotImagesPart | None:
    """Section with the residuals of each shot on its image; None if no camera detected a board.

    pictures : images as `calibrate_rig` takes them: arrays, detections, or functions that return an
    array. Only images that the page shows are read. An image that is not given is replaced by grey.
    """
    named_pictures = name_pictures(pictures or {})
    shots_of = {
        number: sorted(_list_shots(result, number), key=lambda shot: -shot.rms_px)
        for number in range(len(result.cameras))
    }
    arrows = _choose_scale([shot for shots in shots_of.values() for shot in shots[:MOST_SHOTS]])
    cameras = tuple(
        CameraShots(
            result.cameras[number],
            _describe_choice(len(shots)),
            tuple(
                _shot_image(
                    result, number, shot, named_pictures.get(result.cameras[number], {}), arrows
                )
                for shot in shots[:MOST_SHOTS]
            ),
        )
        for number, shots in shots_of.items()
        if shots
    )
    if not cameras:
        return None
    figures = [figure for camera in cameras for figure in camera.figures]
    return ShotImagesPart(cameras, arrows.texts[0], any(figure.left_out for figure in figures))


def _describe_choice(count: int) -> str:
    if count > MOST_SHOTS:
        return f"the {MOST_SHOTS} of {count} shots with the largest residuals, the largest first"
    return f"all {count} shots, the largest residuals first" if count > 1 else "its only shot"


def _list_shots(result: CalibrationResult, camera: int) -> list[_ShotResiduals]:
    """Residuals of each shot of a camera. Several boards in one image count as one shot."""
    rows_of: dict[int, list[int]] = {}
    for row, view in enumerate(result.views):
        if view.camera == camera:
            rows_of.setdefault(view.shot, []).append(row)
    shots = []
    for shot, rows in rows_of.items():
        views = [result.views[row] for row in rows]
        uv_px = np.concatenate(
            [
                v.detection.centres_px if v.grey_level_points is None else v.grey_level_points.uv_px
                for v in views
            ]
        )
        residuals = np.concatenate([result.residuals_px[row] for row in rows])
        used = np.concatenate([view.rows_used for view in views])
        valid = np.isfinite(residuals).all(axis=1) & np.isfinite(uv_px).all(axis=1)
        # Grey levels report pieces of lines beside the points; those without information are none.
        valid &= used | np.concatenate(
            [np.full(v.row_count, v.grey_level_points is None) for v in views]
        )
        if valid.any():
            size_px = views[0].detection.image_size_px
            shots.append(_ShotResiduals(shot, size_px, uv_px[valid], residuals[valid], used[valid]))
    return shots


def _choose_scale(shots: list[_ShotResiduals]) -> Arrows:
    """Common scale of the residuals in all images."""
    shares = [np.linalg.norm(s.residuals_px[s.used], axis=1) / s.size_px[0] for s in shots]
    every = np.concatenate([np.zeros(0), *shares])
    return Arrows.reaching([(float(np.quantile(every, _SHARE)), _REACH)] if len(every) else [])


def _shot_image(
    result: CalibrationResult,
    camera: int,
    residuals: _ShotResiduals,
    pictures: Mapping[str, object],
    arrows: Arrows,
) -> ShotImage:
    name, shot = result.cameras[camera], result.shots[residuals.shot]
    image = deliver(pictures.get(original_shot_name(shot, name)))
    key = f"shot-{camera}-{residuals.shot}"
    array = None if image is None or isinstance(image, Detection) else np.asarray(image)
    picture = page_picture(
        key, array, residuals.size_px, longest_side_px=_SIDE_PX, quality=_QUALITY
    )
    lengths = np.linalg.norm(residuals.residuals_px, axis=1)
    longest = _LONGEST * residuals.size_px[0]
    stretch = np.minimum(arrows.times, longest / np.maximum(lengths, 1e-12))
    ends = residuals.uv_px + stretch[:, None] * residuals.residuals_px
    used, wrong = residuals.used, ~residuals.used
    return ShotImage(
        shot,
        _caption(residuals),
        picture._replace(width_px=residuals.size_px[0], height_px=residuals.size_px[1]),
        _dots(residuals.uv_px[used]),
        _dots(residuals.uv_px[wrong]),
        _lines(residuals.uv_px[used], ends[used]),
        _lines(residuals.uv_px[wrong], ends[wrong]),
    )


def _caption(residuals: _ShotResiduals) -> str:
    """Caption of a shot: rms residual of the used points, and number of excluded points."""
    wrong = int((~residuals.used).sum())
    if wrong == len(residuals.used):
        return f"left out, {with_decimals(residuals.rms_px, 2)} px rms"
    rms_px = residuals._replace(residuals_px=residuals.residuals_px[residuals.used]).rms_px
    caption = f"{with_decimals(rms_px, 3)} px rms"
    return f"{caption}, {wrong} left out" if wrong else caption


def _dots(places_px: Float[np.ndarray, "n 2"]) -> str:
    """SVG path of dots at points (n, 2) px."""
    return "".join(f"M{u:.1f} {v:.1f}h0" for u, v in places_px)


def _lines(from_px: Float[np.ndarray, "n 2"], to_px: Float[np.ndarray, "n 2"]) -> str:
    """SVG path of one line for each point, from (n, 2) to (n, 2) px."""
    return "".join(
        f"M{u:.1f} {v:.1f}l{du:.1f} {dv:.1f}"
        for (u, v), (du, dv) in zip(from_px, to_px - from_px, strict=True)
    )
