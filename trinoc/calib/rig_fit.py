"""From sheets that were found to cameras: by circles, then by grey levels where both agree."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment import (
    Adjustment,
    SheetView,
    adjusted_views,
    apparent_shift,
    points_as_adjusted,
    points_before_flat_sheet,
    probability_of_agreement,
    scatter_of_blocks,
)
from trinoc.calib.detection import Detection
from trinoc.calib.model import SheetPoints
from trinoc.calib.photometric import Encoding, PictureFit, ShiftOfPlaces, refine_views
from trinoc.calib.pose import PoseEstimate, fit_views, pose_of_values
from trinoc.calib.result import Status
from trinoc.calib.targets import Pattern
from trinoc.calib.uncertainty import Systematics
from trinoc.geometry import Intrinsics, Pose, PoseModel

# Both answers of a picture differ by more than this allows in one of a hundred right pictures,
# which pays with a third of its sigmas.
LEAST_PROBABILITY = 1e-2
# Below this many pixels a shift does not bend the profile of an edge.
_LEAST_SHIFT_PX = 0.02
# Blocks of right circles scatter by a half more than they claim once in hundreds of pictures.
_LARGEST_SCATTER = 1.5

# Ink that spreads less moves the centres of circles by less than they are known to.
_LEAST_SPREAD_MM = 0.01

Method = Literal["picture", "circles"]


class FoundSheet(NamedTuple):
    """One camera's picture of the sheet, before any fit.

    Fields
    ------
    name : of the camera.
    detection : the circles and lines that were found.
    lens : as the user says it.
    lens_factor : (k, r) of its covariance; None for a lens that is exact.
    image : (h, w) grey levels; None where the circles alone count.
    """

    name: str
    detection: Detection
    lens: Intrinsics
    lens_factor: Float[np.ndarray, "_k _r"] | None
    image: Float[np.ndarray, "_h _w"] | None


class Knowledge(NamedTuple):
    """What is known of all cameras before they are fitted.

    Fields
    ------
    pattern : the sheet.
    model : what the user wants to know of each pose.
    systematics : what is not exact.
    encoding : how the pictures' grey levels stand for light.
    """

    pattern: Pattern
    model: PoseModel
    systematics: Systematics
    encoding: Encoding = Encoding()

    @property
    def aim_is_held(self) -> bool:
        """Whether the optical axes meet the origin exactly."""
        return self.model is PoseModel.AIMED and not self.systematics.aim_sigma_mm

    @property
    def fitted_model(self) -> PoseModel:
        """What is free of each pose."""
        return PoseModel.AIMED if self.aim_is_held else PoseModel.AIM_FREE

    @property
    def aim_sigma_mm(self) -> float:
        """Of the prior on the aim; 0 for none."""
        return self.systematics.aim_sigma_mm if self.model is PoseModel.AIMED else 0.0


class CameraFitting(NamedTuple):
    """How one camera came to its answer.

    Fields
    ------
    sheet : what was found.
    points : the circles.
    picture : what its grey levels say; None where they were not asked.
    method : whose answer it is.
    agreement : probability that both answers differ as they do; NaN where there is one.
    scatter : by how much its circles' blocks scatter beyond their noise.
    """

    sheet: FoundSheet
    points: SheetPoints
    picture: PictureFit | None
    method: Method
    agreement: float
    scatter: float


class RigFit(NamedTuple):
    """All cameras: how each came to its answer, the answer, and that of the circles alone."""

    cameras: list[CameraFitting]
    adjustment: Adjustment
    of_circles: Adjustment


def fitted_circles(sheets: Sequence[FoundSheet], known: Knowledge) -> list[PoseEstimate]:
    """Each camera from its circles alone; with its aim held where that is all they determine."""
    detections, lenses = [sheet.detection for sheet in sheets], [sheet.lens for sheet in sheets]
    fits = fit_views(detections, known.pattern, lenses, known.fitted_model)
    if known.model is PoseModel.AIM_FREE or known.aim_is_held:
        return fits
    weak = [k for k, fit in enumerate(fits) if fit.status is not Status.CONVERGED]
    chosen = [detections[k] for k in weak], known.pattern, [lenses[k] for k in weak]
    for k, fit in zip(weak, fit_views(*chosen, known.model), strict=True):
        fits[k] = fit
    return fits


def fit_rig(
    sheets: Sequence[FoundSheet], circles: Sequence[PoseEstimate], known: Knowledge
) -> RigFit:
    """All cameras adjusted together, each by its picture where that agrees with its circles.

    circles : a converged fit of each.
    """
    starts = [pose_of_values(fit.values) for fit in circles]
    by_circles, of_circles = _fitted_by_circles(sheets, starts, known)
    pictures = _pictures(sheets, starts, [view.points for view in by_circles], of_circles, known)
    spreads_mm = [
        picture.quality.ink_spread_mm if picture and picture.quality else 0.0
        for picture in pictures
    ]
    if max(abs(spread) for spread in spreads_mm) > _LEAST_SPREAD_MM:
        # Larger circles are seen with their centres further aside.
        by_circles = _corrected(by_circles, sheets, of_circles, known, spreads_mm)
        of_circles = _adjusted(by_circles, known, of_circles)
    by_picture = [
        _seen_by_picture(view, picture) for view, picture in zip(by_circles, pictures, strict=True)
    ]
    asked = [view is not None for view in by_picture]
    either = [old if new is None else new for new, old in zip(by_picture, by_circles, strict=True)]
    of_pictures = _adjusted(either, known, of_circles) if any(asked) else of_circles
    cameras = [
        _judged(k, sheet, by_circles[k].points, pictures[k], asked[k], of_circles, of_pictures)
        for k, sheet in enumerate(sheets)
    ]
    final = of_pictures if any(one.method == "picture" for one in cameras) else of_circles
    # Some cameras by their pictures and some not, or circles that know less than they say.
    if len({one.method for one in cameras}) > 1 or max(one.scatter for one in cameras) > 1.0:
        views = [
            either[k] if one.method == "picture" else _scattered(by_circles[k], one.scatter)
            for k, one in enumerate(cameras)
        ]
        final = _adjusted(views, known, of_circles)
    return RigFit(cameras, final, of_circles)


def _fitted_by_circles(
    sheets: Sequence[FoundSheet], starts: Sequence[Pose], known: Knowledge
) -> tuple[list[SheetView], Adjustment]:
    """The circles' centres, and all cameras adjusted by them."""
    views = [
        SheetView(
            points_before_flat_sheet(sheet.detection, known.pattern, start, sheet.lens.lens),
            start,
            sheet.lens.lens,
            sheet.lens_factor,
            has_outliers=True,
        )
        for start, sheet in zip(starts, sheets, strict=True)
    ]
    adjustment = _adjusted(views, known)
    if known.systematics.are_none:
        return views, adjustment
    views = _corrected(views, sheets, adjustment, known, [0.0] * len(sheets))
    return views, _adjusted(views, known, adjustment)


def _seen_by_picture(view: SheetView, picture: PictureFit | None) -> SheetView | None:
    """The view with the places that its grey levels show; None where they show none."""
    if picture is None or picture.points is None:
        return None
    # What its own pixels left out is no place that may be wrong.
    return view._replace(points=picture.points, has_outliers=False)


def _judged(
    view: int,
    sheet: FoundSheet,
    points: SheetPoints,
    picture: PictureFit | None,
    asked: bool,
    of_circles: Adjustment,
    of_pictures: Adjustment,
) -> CameraFitting:
    """Whose answer one camera takes."""
    agreement = (
        probability_of_agreement(of_circles, of_pictures, points, view) if asked else float("nan")
    )
    if asked and (
        agreement >= LEAST_PROBABILITY or _circles_are_wrong(of_circles, of_pictures, view)
    ):
        return CameraFitting(sheet, points, picture, "picture", agreement, 1.0)
    scatter = _scatter(of_circles, points, view, refuted=asked)
    return CameraFitting(sheet, points, picture, "circles", agreement, scatter)


def _corrected(
    views: Sequence[SheetView],
    sheets: Sequence[FoundSheet],
    of_circles: Adjustment,
    known: Knowledge,
    spreads_mm: Sequence[float],
) -> list[SheetView]:
    """The views with their circles' centres as the adjustment and the ink's spread have them."""
    return [
        view._replace(
            points=points_as_adjusted(sheet.detection, known.pattern, of_circles, k, spread)
        )
        for k, (view, sheet, spread) in enumerate(zip(views, sheets, spreads_mm, strict=True))
    ]


def _adjusted(
    views: Sequence[SheetView], known: Knowledge, near: Adjustment | None = None
) -> Adjustment:
    model, aim_sigma_mm = known.fitted_model, known.aim_sigma_mm
    return adjusted_views(views, known.systematics, model, aim_sigma_mm, near)


def _pictures(
    sheets: Sequence[FoundSheet],
    starts: Sequence[Pose],
    points: Sequence[SheetPoints],
    of_circles: Adjustment,
    known: Knowledge,
) -> list[PictureFit | None]:
    """The fit of each picture that is there, around what the circles show of bend and lens."""
    images, poses, lenses = {}, {}, {}
    shifts: dict[str, ShiftOfPlaces] = {}
    for k, sheet in enumerate(sheets):
        if sheet.image is None:
            continue
        images[sheet.name], poses[sheet.name] = sheet.image, starts[k]
        lenses[sheet.name] = sheet.lens.lens
        shift = apparent_shift(of_circles, k, starts[k], sheet.lens.lens)
        if np.abs(shift(points[k].place_mm)).max() > _LEAST_SHIFT_PX:
            shifts[sheet.name] = shift
    model = known.fitted_model
    found = refine_views(images, poses, known.pattern, lenses, model, shifts, known.encoding)
    return [found.get(sheet.name) for sheet in sheets]


def _circles_are_wrong(of_circles: Adjustment, of_pictures: Adjustment, view: int) -> bool:
    """Whether, of two answers that differ, the circles' is the one that its data speak against."""
    return bool(of_circles.enlarged[view] > _LARGEST_SCATTER and of_pictures.enlarged[view] == 1.0)


def _scatter(of_circles: Adjustment, points: SheetPoints, view: int, *, refuted: bool) -> float:
    """How much the circles' sigmas must grow; by all that blocks say where the model is wrong."""
    scatter = scatter_of_blocks(of_circles, points.place_mm, view)
    return scatter if refuted or scatter > _LARGEST_SCATTER else 1.0


def _scattered(view: SheetView, scatter: float) -> SheetView:
    whitening = view.points.whitening / scatter
    return view._replace(points=view.points._replace(whitening=whitening))
