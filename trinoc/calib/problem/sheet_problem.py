"""Problem of cameras that observe one sheet of paper in one shot.

Every stated standard deviation is the prior of an unknown: D. C. Brown, "The bundle adjustment -
progress and prospects", 1976, calls this self-calibration with additional parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.image_quality import ImageQuality
from trinoc.calib.problem.problem import Problem, basis_of_scales, stack_problem_lenses
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.problem.variables import POSE_SIZE, Parametrization, Priors, RigState
from trinoc.calib.problem.views import LINE_PIECES, BoardObservation, SheetPoints, pad_count
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import CAMERAS_AT_ONCE, Systematics
from trinoc.errors import check_kind
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.pose import Pose, PoseModel

Method = Literal["pixels", "points"]


@dataclass(frozen=True, eq=False)
class GreyLevelFit:
    """Result of the fit to the grey levels of one image, or the reason why the fit failed.

    Attributes
    ----------
    points : pixel of each circle and of each piece of the sheet's crossed lines, fitted to the grey
        levels, with the inverse covariance of the pixels; None after a failure.
    quality : light, ink, blur and noise of the image.
    note : sentence with the reason of a failure; None after success.
    is_processed : whether software has sharpened the image.
    """

    points: SheetPoints | None
    quality: ImageQuality | None
    note: str | None
    is_processed: bool = False

    def __post_init__(self) -> None:
        if (self.points is None) != (self.note is not None):
            raise ValueError("A fit of grey levels has either points or a note.")


@dataclass(frozen=True, eq=False)
class SheetCamera:
    """Input of the adjustment for one camera: its observations of the sheet and its lens.

    Attributes
    ----------
    name : name of the camera.
    detection : detected circles and lines.
    lens : intrinsics given by the user.
    lens_factor : (k, r) factor L of the covariance L L^T of the first k lens parameters; None if
        the lens is assumed exact.
    pose : initial pose, cam_from_world.
    image : (h, w) grey levels; None if only circles are used.
    grey_level_fit : result of the fit to the grey levels of `image`.
    grey_level_points : points fitted to the grey levels, which are used instead of the circle
        centres; None if the circle centres are used.
    ink_spread_mm : distance by which ink extends beyond the drawn edge of each circle.
    agreement_p_value : p-value of the test that circle centres and grey levels give the same pose.
        A small value means that they contradict each other. NaN without grey levels.
    sigma_factor : factor by which the sigmas of the circle centres are multiplied.
    """

    name: str
    detection: Detection
    lens: Intrinsics
    lens_factor: Float[np.ndarray, "_k _r"] | None
    pose: Pose
    image: Float[np.ndarray, "_h _w"] | None = None
    grey_level_fit: GreyLevelFit | None = None
    grey_level_points: SheetPoints | None = None
    ink_spread_mm: float = 0.0
    agreement_p_value: float = float("nan")
    sigma_factor: float = 1.0

    @property
    def method(self) -> Method:
        """ "pixels" if grey levels are used, "points" if circle centres are."""
        return "points" if self.grey_level_points is None else "pixels"

    def by_pixels(self) -> "SheetCamera":
        """Copy that uses the grey-level points if they exist, else the circle centres."""
        return replace(self, grey_level_points=self.grey_level_fit and self.grey_level_fit.points)

    @property
    def largest_point_count(self) -> int:
        """Upper bound of the number of grey-level points: one for each circle and for each piece of
        the sheet's crossed lines.
        """
        count = 0 if self.grey_level_points is None else len(self.grey_level_points.point_mm)
        return max(len(self.detection) + 4 * LINE_PIECES, count)

    @property
    def promoted_lens(self) -> AbstractLens:
        """The camera's lens in a lens model with distortion coefficients, which may be 0."""
        return promote_lens(self.lens.lens)


@dataclass(frozen=True)
class SheetPriors:
    """Priors of sheet, lenses and aims, and the pose model.

    Attributes
    ----------
    pose_model : pose parameters that the user requested.
    systematics : standard deviations of the errors of sheet, lenses and aims.
    tuning : constants of the method.
    """

    pose_model: PoseModel
    systematics: Systematics
    tuning: CalibTuning = TUNING

    def __post_init__(self) -> None:
        """Raise `InputError` if `systematics` has another type, or a sigma is negative or not
        finite.
        """
        check_kind(self.systematics, Systematics, "knowledge of the sheet", "trinoc.Systematics")
        self.systematics.check()

    @property
    def aim_is_fixed(self) -> bool:
        """True if the optical axes are assumed to meet the origin of the sheet exactly."""
        return self.pose_model is PoseModel.AIMED and not self.systematics.aim_sigma_mm

    @property
    def fitted_model(self) -> PoseModel:
        """Pose parameters that the fit estimates. With an uncertain aim, they include the aim."""
        if self.pose_model is PoseModel.AIMED and self.systematics.aim_sigma_mm:
            return PoseModel.AIM_FREE
        return self.pose_model

    @property
    def aim_sigma_mm(self) -> float:
        """Prior standard deviation of each aim coordinate, mm; 0 if the aim has no prior."""
        return self.systematics.aim_sigma_mm if self.pose_model is PoseModel.AIMED else 0.0


def sheet_problem(
    cameras: Sequence[SheetCamera],
    target: AbstractTarget,
    priors: SheetPriors,
) -> Problem:
    """Build the calibration problem of cameras that observe one sheet, with its initial values.

    Initially the sheet is flat and as drawn. It lies on the plane Z = 0.
    """
    count, systematics, model = len(cameras), priors.systematics, priors.fitted_model
    padded = [cameras[min(k, count - 1)] for k in range(pad_count(count, CAMERAS_AT_ONCE))]
    is_real = np.arange(len(padded)) < count
    lens_of_camera = np.arange(len(padded))
    if systematics.lens_is_shared and _are_one_lens(cameras):
        lens_of_camera = np.zeros(len(padded), dtype=int)
    lenses = [padded[k].promoted_lens for k in range(lens_of_camera[-1] + 1)]
    scale = np.stack(
        [lens.parameter_scales(camera.lens.image_size_px) for lens, camera in zip(lenses, padded)]
    )
    basis, lens_information = basis_of_scales(scale), np.zeros((*scale.shape, scale.shape[1]))
    lens_free = np.zeros(scale.shape)
    for k, camera in enumerate(padded[: len(lenses)]):
        if camera.lens_factor is not None and is_real[k]:
            basis[k], lens_information[k], lens_free[k] = _lens_prior(camera.lens_factor, scale[k])
    sigma = BentPaper.sigmas(
        systematics.print_size_sigma,
        systematics.print_scale_sigma,
        systematics.flatness_mm,
        priors.tuning.problem.height_shares,
    )
    radius_mm = max(float(np.hypot(*_points_mm(camera, target).T[:2]).max()) for camera in cameras)
    unit_mm = np.median([_camera_distance_mm(camera, target) for camera in cameras])
    pose_free = np.outer(is_real, np.arange(POSE_SIZE) < model.size)
    parametrization = Parametrization(
        lens_basis=basis,
        unit_mm=np.asarray(unit_mm),
        sheet_model=BentPaper(np.asarray(radius_mm)),
        sheet_scale=np.where(sigma > 0, sigma, 1.0),
        lens_of_camera=lens_of_camera,
        free=np.concatenate([lens_free.ravel(), pose_free.ravel(), sigma > 0]).astype(float),
        boards_free=np.zeros(()),
        priors=Priors(
            lens_mean=np.stack([np.asarray(lens.parameters) for lens in lenses]),
            lens_information=lens_information,
            sheet_information=np.diag((sigma > 0) / np.where(sigma > 0, sigma, 1.0) ** 2),
            shape_information=np.zeros((0, 0)),
            aim_information=is_real * (priors.aim_sigma_mm**-2 if priors.aim_sigma_mm > 0 else 0.0),
        ),
        pose_model=model if model is PoseModel.RIGID else PoseModel.AIM_FREE,
        has_circles=bool(np.any(target.radius_mm > 0)),
    )
    state = RigState(
        lenses=stack_problem_lenses(lenses),
        cam_from_rig=np.stack([np.asarray(camera.pose.cam_from_world) for camera in padded]),
        rig_from_board=np.eye(3, 4)[None],
        set_from_board=np.zeros((0, 3, 4)),
        sheet=np.zeros(len(sigma)),
        shape=np.zeros((0, 3)),
    )
    views = tuple(
        BoardObservation(
            camera=k,
            shot=0,
            detection=camera.detection,
            used=np.ones(len(camera.detection), dtype=bool),
            grey_level_points=camera.grey_level_points,
            ink_spread_mm=camera.ink_spread_mm,
            spare_rows=0
            if camera.image is None
            else camera.largest_point_count - len(_points_mm(camera, target)),
            sigma_ratio=camera.sigma_factor,
        )
        for k, camera in enumerate(cameras)
    )
    return Problem(
        views,
        target,
        state,
        parametrization,
        shots=1,
        sigma_factor=np.ones(len(padded)),
        tuning=priors.tuning,
    )


def _lens_prior(
    factor: Float[np.ndarray, "k r"], scale: Float[np.ndarray, "q"]
) -> tuple[Float[np.ndarray, "q q"], Float[np.ndarray, "q q"], Float[np.ndarray, "q"]]:
    """Parametrization of a lens by the columns of the factor L of its prior covariance L L^T.

    Returns the basis, (q, q), whose first r columns are one-sigma changes of the q lens parameters;
    the information of the prior, (q, q); and the mask of the estimated columns, (q,).

    factor : (k, r) L, for the first k parameters.
    scale : (q,) typical change of each lens parameter.
    """
    parameters, steps = factor.shape
    size = len(scale)
    basis, information = np.zeros((size, size)), np.zeros((size, size))
    basis[:parameters, :steps] = factor
    inverse = np.linalg.pinv(factor / scale[:parameters, None]) / scale[None, :parameters]
    information[:parameters, :parameters] = inverse.T @ inverse
    return basis, information, (np.arange(size) < steps).astype(float)


def _are_one_lens(cameras: Sequence[SheetCamera]) -> bool:
    first = np.asarray(cameras[0].promoted_lens.parameters)
    return all(
        np.array_equal(np.asarray(camera.promoted_lens.parameters), first) for camera in cameras
    )


def _camera_distance_mm(camera: SheetCamera, target: AbstractTarget) -> float:
    """Distance from the camera's centre of projection to the mean of its observed
    board points, mm.
    """
    middle = np.zeros(3)
    points_mm = _points_mm(camera, target)
    middle[: points_mm.shape[1]] = points_mm.mean(axis=0)
    return float(np.linalg.norm(camera.pose.transform(middle)))


def _points_mm(camera: SheetCamera, target: AbstractTarget) -> Float[np.ndarray, "n _"]:
    if camera.grey_level_points is not None:
        return camera.grey_level_points.point_mm
    return target.centres_mm[camera.detection.circle_index]
