"""The result of every calibration: a rig, its covariance, and the status and fit of each camera."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.image_quality import ImageQuality as ImageQuality
from trinoc.calib.problem.problem import SolvedProblem, lens_number
from trinoc.calib.problem.status import Status as Status
from trinoc.calib.problem.views import BoardObservation
from trinoc.calib.result.camera_pairs import CameraPair, camera_pairs
from trinoc.calib.result.halves import CrossValidation, HalvesCheck
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import list_boards
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, AnswerTuning
from trinoc.calib.uncertainty.pixel_sigma import PixelSigma, compute_pixel_sigma
from trinoc.calib.uncertainty.propagation import MAP_SIZE, field_grid_px, field_sigma_px
from trinoc.errors import CalibrationError, InputError, list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import Rig
from trinoc.numerics.display import Displayable
from trinoc.numerics.values import Value


class FixedParameterTest(NamedTuple):
    """Score test of one parameter group that the model fixes: would the residuals change it?

    Fields
    ------
    name : "aim", "focal length", "aspect", "principal point" or "radial distortion".
    chi_square_drop : reduction of chi-square if the group were estimated.
    p_value : probability of such a reduction by noise alone.
    estimate : (k,) change of the group, in mm of the aim, as a share of the focal length, as a
        share of fy against fx, in px, or in k1.
    sigma : (k,) standard deviation of `estimate`.

    strain : Mahalanobis length of the motion of the camera by `estimate`.
    undetectable : (k,) the change, too small for a reliable detection, that would move the camera
        most.
    undetectable_strain : Mahalanobis length of the motion of the camera by `undetectable`.
    undetectable_motion : (p,) change of the camera's parameters by `undetectable`, degrees and mm.
    tuning : limits of probability and strain for a significant test.
    """

    name: str
    chi_square_drop: float
    p_value: float
    estimate: Float[np.ndarray, "k"]
    sigma: Float[np.ndarray, "k"]
    strain: float
    undetectable: Float[np.ndarray, "k"]
    undetectable_strain: float
    undetectable_motion: Float[np.ndarray, "p"]
    tuning: AnswerTuning = TUNING.answer

    @property
    def is_significant(self) -> bool:
        """True if noise alone is an unlikely cause of the reduction."""
        return self.p_value < self.tuning.chance

    @property
    def is_strained(self) -> bool:
        """True if the change is both unlikely to be noise and large for the camera."""
        is_rare = self.p_value < self.tuning.chance_where_strained
        return is_rare and self.strain > self.tuning.strain_sigmas


class CameraFit(Value):
    """Fit of one camera to its observations.

    Fields
    ------
    residuals_px : (m, 2) predicted minus observed pixel of each circle, corner or point, over all
        images of the camera.
    used : (m,) whether each observation was used; the others are outliers.
    rank : number of the camera's parameters that the observations determine.
    reduced_chi_square : chi-square of the circles or corners over their degrees of freedom. For a
        sheet, with the stated sigmas; for boards in many shots, with the sigmas multiplied by
        `sigma_factor`.
    sigma_factor : factor by which the stated sigmas of the observations were multiplied. For
        points, which have no stated sigma: standard deviation of a coordinate, px.
    gauge : names of the parameters that the observations do not determine.
    notes : sentences for the user, for instance on covered circles or outliers.
    detections : detections in the images of a sheet. Empty for points and for boards in many shots,
        whose detections are in `CalibrationResult.views`.
    image : quality of the image from the fit to its grey levels; None if only circles were fitted.
    fixed_parameter_tests : tests of everything that the model fixes.
    method : "pixels" if grey levels were fitted, else "points".
    """

    residuals_px: Float[np.ndarray, "m 2"]
    used: Bool[np.ndarray, "m"]
    rank: int = eqx.field(static=True)
    reduced_chi_square: float = eqx.field(static=True)
    gauge: tuple[str, ...] = eqx.field(static=True, default=())
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    sigma_factor: float = eqx.field(static=True, default=1.0)
    detections: tuple[Detection, ...] = ()
    image: ImageQuality | None = None
    fixed_parameter_tests: tuple[FixedParameterTest, ...] = ()
    method: str = eqx.field(static=True, default="points")

    def __check_init__(self) -> None:
        if len(self.residuals_px) != len(self.used):
            raise ValueError("residuals_px and used have a row for each observation.")

    @property
    def detection(self) -> Detection:
        """Detection in the camera's only image of a sheet."""
        (only,) = self.detections
        return only

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals of the used observations, px."""
        squared = np.sum(self.residuals_px[self.used] ** 2, axis=1)
        return float(np.sqrt(np.mean(squared))) if len(squared) else float("nan")


class CalibrationResult(Displayable, Value):
    """A calibrated rig with its parameters, their covariance, and the fit of each camera.

    Every calibration returns this type: `calibrate`, `calibrate_rig`, `calibrate_intrinsics` (a rig
    of one camera in its own frame) and `calibrate_points` (a rig of one camera).

    Fields
    ------
    solution : rig of all cameras whose parameters are determined; None without one. Read it as
        `rig`.
    status : how the fit of each camera ended, failed cameras included. Cameras that were fitted
        together have the same status.
    parameters : names such as "upper.pan_deg", "left.fx_px", "board.warp_x_mm".
    values : (p,) values of `parameters`, in degrees, mm and px; NaN if not determined.
    covariance : (p, p) covariance of `parameters`; 0 for fixed ones, NaN for undetermined ones.
    fits : fit of each camera with a detection.
    target : the sheet or board; None for points.
    failures : reason for each camera, or "camera, shot", without a result.
    systematics : descriptions of the errors beyond noise that the covariance contains.
    notes : sentences for the user.
    advice : sentence on the measurement that would reduce the sigmas; empty without one.
    gauge : names of the parameters that the observations do not determine.

    Only for boards in many shots:

    reduced_chi_square : of all observations, after their sigmas were multiplied by
        `CameraFit.sigma_factor`.
    refused : sentences on shots and images that were not used.
    world : description of the shot or camera whose frame is the world's.
    shots : names of the used shots.
    world_from_board : (s, 3, 4) pose of the board in each shot, mm; for a set, of its first board.
    reference_from_board : (b, 3, 4) pose of each board of a set relative to the first one, mm; the
        identity for one board. The sigmas are those of "board.NAME.turn_x_deg", about the axes of
        the first board, and of "board.NAME.x_mm".
    place_shifts_mm : (n, 3) X, Y and Z displacement of each corner or circle centre from the
        drawing with its warp; no rows if the shots show none.
    views : observations of each camera in each shot, with the used corners or circles.
    residuals_px : for each view (m, 2) predicted minus observed corners or circles. With grey
        levels: each circle and, across the line, each piece of a line.
    halves : comparison of two halves of the shots; None for too few shots.
    cross_validation : errors of shots that the rig was not fitted to; None for too few shots.
    solved_problem : the problem at its solution, for `next_shot`; None if the fit did not converge.
    is_lens : whether this is a lens of `calibrate_intrinsics`, whose pose has no meaning. It is
        saved as a lens.
    """

    solution: Rig | None
    status: dict[str, Status]
    parameters: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    fits: dict[str, CameraFit]
    target: AbstractTarget | None
    failures: dict[str, str] = eqx.field(default_factory=dict)
    systematics: tuple[str, ...] = eqx.field(static=True, default=())
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    advice: str = eqx.field(static=True, default="")
    gauge: tuple[str, ...] = eqx.field(static=True, default=())
    reduced_chi_square: float = eqx.field(static=True, default=float("nan"))
    refused: tuple[str, ...] = eqx.field(static=True, default=())
    world: str = eqx.field(static=True, default="the sheet")
    shots: tuple[str, ...] = eqx.field(static=True, default=())
    world_from_board: Float[np.ndarray, "s 3 4"] = eqx.field(
        default_factory=lambda: np.zeros((0, 3, 4))
    )
    reference_from_board: Float[np.ndarray, "b 3 4"] = eqx.field(
        default_factory=lambda: np.eye(3, 4)[None]
    )
    place_shifts_mm: Float[np.ndarray, "n 3"] = eqx.field(default_factory=lambda: np.zeros((0, 3)))
    views: tuple[BoardObservation, ...] = ()
    residuals_px: tuple[Float[np.ndarray, "_m 2"], ...] = ()
    halves: HalvesCheck | None = None
    cross_validation: CrossValidation | None = None
    solved_problem: SolvedProblem | None = None
    is_lens: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        count = len(self.parameters)
        if self.values.shape != (count,) or self.covariance.shape != (count, count):
            raise ValueError("values and covariance have a row for each parameter.")
        if len(self.views) != len(self.residuals_px):
            raise ValueError("views and residuals_px have an entry for each other.")

    @property
    def has_rig(self) -> bool:
        """True if a camera is determined, so that `rig` exists."""
        return self.solution is not None

    @property
    def rig(self) -> Rig:
        """The determined cameras, with the covariance of poses and lenses.

        Raises
        ------
        CalibrationError : no camera is determined. The sentence gives the reason.
        """
        if self.solution is None:
            reason = self.notes[0] if self.notes else self.overall_status.value
            raise CalibrationError(f"No rig was determined. {reason}", dict(self.failures), self)
        return self.solution

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of all cameras, failed ones included."""
        return tuple(self.status)

    @property
    def camera(self) -> Camera:
        """The only camera. Raises InputError for a rig of several."""
        return self.rig[self._only_camera()]

    @property
    def lens(self) -> Intrinsics:
        """Intrinsics of the only camera. Raises InputError for a rig of several."""
        return self.camera.intrinsics

    @property
    def lens_parameters(self) -> tuple[str, ...]:
        """Names of the parameters of the only lens, such as "fx_px", in the order of `values`."""
        prefix = f"{self._only_camera()}."
        names = [name.removeprefix(prefix) for name in self.parameters if name.startswith(prefix)]
        pose_parameters = {parameter for model in PoseModel for parameter in model.parameter_names}
        return tuple(name for name in names if name not in pose_parameters)

    @property
    def lens_covariance(self) -> Float[np.ndarray, "q q"]:
        """Covariance of the parameters of the only lens, (q, q); 0 for fixed parameters.

        A lens without distortion has the parameters of Brown and Conrady's model.
        """
        names = promote_lens(self.lens.lens).parameter_names
        rows = [self._row(f"{self._only_camera()}.{name}") for name in names]
        nonzero = [k for k, row in enumerate(rows) if row is not None]
        covariance = np.zeros((len(names), len(names)))
        result_rows = [row for row in rows if row is not None]
        covariance[np.ix_(nonzero, nonzero)] = self.covariance[np.ix_(result_rows, result_rows)]
        return covariance

    @property
    def board(self) -> AbstractTarget:
        """The sheet or board. Raises InputError for points."""
        if self.target is None:
            raise InputError("This camera was calibrated from points: it has no board.")
        return self.target

    @property
    def pattern(self) -> Pattern:
        """The sheet of circles. Raises InputError for another board, and for points."""
        if not isinstance(self.board, Pattern):
            raise InputError(
                f"The board is a {type(self.board).__name__}, not a sheet of circles: use the "
                "attribute `board`."
            )
        return self.board

    @property
    def overall_status(self) -> Status:
        """The worst status of all cameras."""
        return max(self.status.values(), key=list(Status).index)

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter, in its own unit.

        Parameters
        ----------
        parameter : name such as "upper.pan_deg"; for a single camera also "fx_px".

        Returns
        -------
        The standard deviation; 0 for a fixed parameter, NaN for one that is not determined.

        Raises
        ------
        InputError : the name is not a parameter.
        """
        row = self._row(parameter)
        if row is None:
            return self.rig.sigma(parameter)
        return float(np.sqrt(self.covariance[row, row]))

    def value(self, parameter: str) -> float:
        """Value of a parameter; names and errors as in `sigma`."""
        row = self._row(parameter)
        return self.rig.value(parameter) if row is None else float(self.values[row])

    def rms_px(self, camera: str | None = None) -> float:
        """Root mean square length of the used residuals of one camera, or of all cameras, px."""
        fits = self.fits.values() if camera is None else [self.fits[camera]]
        residuals_px = [fit.residuals_px[fit.used] for fit in fits]
        used_px = np.concatenate([np.zeros((0, 2)), *residuals_px])
        return float(np.sqrt(np.mean(np.sum(used_px**2, axis=1)))) if len(used_px) else float("nan")

    @property
    def pairs(self) -> tuple[CameraPair, ...]:
        """Baseline and relative rotation of each pair of cameras, with sigmas; empty without a rig.

        Pairs with the first camera come first.
        """
        if self.solution is None:
            return ()
        return camera_pairs(self.solution, self.parameters, self.covariance)

    @property
    def pixel_sigma(self) -> PixelSigma | None:
        """Standard deviation of the pixel of a fixed point at the distance of the boards; None
        without shots.
        """
        if self.solution is None or not self.views:
            return None
        distances_mm = {name: self.board_distance_mm(name) for name in self.cameras}
        return compute_pixel_sigma(self.solution, self.parameters, self.covariance, distances_mm)

    @property
    def field_sigma_px(self) -> Float[np.ndarray, "5 5"]:
        """Standard deviation per axis of the pixel at which the only lens images a ray, px, (5, 5).

        The grid covers the image from corner to corner. A common turn of the camera is removed. NaN
        where the lens images no ray, or if the lens is not determined.
        """
        camera = self._only_camera()
        if self.solution is None or self.solved_problem is None:
            return np.full((MAP_SIZE, MAP_SIZE), np.nan)
        lens = lens_number(self.solved_problem.problem, 0)
        rows = [self.parameters.index(f"{camera}.{name}") for name in lens.parameter_names]
        places_px = field_grid_px(self.lens.image_size_px)
        return np.asarray(field_sigma_px(lens, self.covariance[np.ix_(rows, rows)], places_px))

    def board_distance_mm(self, camera: str) -> float:
        """Median distance from a camera to the middle of the boards that it saw, mm; of all boards
        if none.

        Raises CalibrationError without a rig.
        """
        number = self.cameras.index(camera)
        used_views = [v for v in self.views if v.camera == number and v.used.any()]
        pairs = {(view.shot, view.board) for view in used_views}
        pairs = pairs or {(shot, 0) for shot in range(len(self.world_from_board))}
        shots, boards = np.array(sorted(pairs)).T
        extents = [np.asarray(board.centres_mm) for board in list_boards(self.board)]
        middles = np.stack([(extent.min(axis=0) + extent.max(axis=0)) / 2 for extent in extents])
        reference_poses, poses = self.reference_from_board, self.world_from_board[shots]
        middles = (
            np.einsum("bij,bj->bi", reference_poses[:, :, :2], middles) + reference_poses[:, :, 3]
        )
        middles_mm = np.einsum("sij,sj->si", poses[:, :, :3], middles[boards]) + poses[:, :, 3]
        centre = np.asarray(self.rig[camera].centre_world_mm)
        return float(np.median(np.linalg.norm(middles_mm - centre, axis=1)))

    def summary(self) -> str:
        """Text with all parameters, their standard deviations, and the quality of each fit."""
        from trinoc.calib.result.summary import summarise

        return summarise(self)

    def _only_camera(self) -> str:
        if len(self.status) != 1:
            raise InputError(
                f"There are several cameras, {list_names(self.cameras)}: name one, as in "
                f'result.rig["{self.cameras[0]}"].'
            )
        return self.cameras[0]

    def _row(self, parameter: str) -> int | None:
        names = [parameter]
        if len(self.status) == 1:
            names.append(f"{self.cameras[0]}.{parameter}")
        return next(
            (self.parameters.index(name) for name in names if name in self.parameters), None
        )
