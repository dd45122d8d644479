"""The result of every calibration: a rig, its covariance, and the status and fit of each camera."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.image_quality import ImageQuality as ImageQuality
from trinoc.calib.problem.problem import SolvedProblem, lens_of_index
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
    """Score test of one group of parameters that a fit assumed exact.

    The test predicts, without a new fit, how these parameters would change if they were estimated.

    Attributes
    ----------
    name : "aim", "focal length", "aspect", "principal point" or "radial distortion".
    chi_square_drop : predicted reduction of chi-square if the group were estimated.
    p_value : probability that noise alone causes an equal or larger reduction.
    estimate : (k,) predicted change of the group. Unit: mm for the aim; relative for the focal
        length and for fy / fx (aspect); px for the principal point; change of k1 for the
        distortion.
    sigma : (k,) standard deviation of `estimate`.
    strain : change of the camera's pose by `estimate`, in sigmas (Mahalanobis distance).
    undetectable : (k,) error of the group that the test detects only with a given probability, in
        the direction that changes the pose most.
    undetectable_strain : change of the camera's pose by `undetectable`, in sigmas.
    undetectable_motion : (p,) change of the camera's pose parameters by `undetectable`, degrees and
        mm.
    tuning : limits of p-value and strain for a significant test.
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
        """True if noise alone is unlikely to cause the predicted reduction of chi-square."""
        return self.p_value < self.tuning.chance

    @property
    def is_strained(self) -> bool:
        """True if the test is significant, and the change of the camera's pose is large."""
        is_rare = self.p_value < self.tuning.chance_where_strained
        return is_rare and self.strain > self.tuning.strain_sigmas


class CameraFit(Value):
    """Fit of one camera to its observations.

    Attributes
    ----------
    residuals_px : (m, 2) predicted minus observed pixel of each circle, corner or point, in all
        images of the camera.
    used : (m,) whether each observation was used; outliers were not.
    rank : number of directions of the camera's parameters that the observations determine.
    reduced_chi_square : chi-square of the circles or corners divided by their degrees of freedom.
        For one image of a sheet, it uses the stated sigmas. For boards in many shots, it uses the
        sigmas multiplied by `sigma_factor`.
    sigma_factor : factor by which the stated sigmas of the observations were multiplied. For
        points, which have no stated sigma: standard deviation of a coordinate, px.
    gauge : names of the parameters that the observations do not determine.
    notes : warnings for the user, for instance about covered circles or outliers.
    detections : detections in the images of a sheet. Empty for points and for boards in many shots,
        whose detections are in `CalibrationResult.views`.
    image : quality of the image, from the fit to its grey levels; None if only circles were fitted.
    fixed_parameter_tests : tests of all parameters that the fit assumed exact.
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

    Attributes
    ----------
    solution : rig of all cameras whose parameters are determined; None if there are none. Read it
        as `rig`, which then raises an error with the reason.
    status : status of the fit of each camera, failed cameras included. Cameras that were fitted
        together have the same status.
    parameters : names such as "upper.pan_deg", "left.fx_px", "board.warp_x_mm".
    values : (p,) values of `parameters`, in degrees, mm and px; NaN if not determined.
    covariance : (p, p) covariance of `parameters`; 0 for fixed ones, NaN for undetermined ones.
    fits : fit of each camera with a detection.
    target : the sheet or board; None for points.
    failures : reason for each camera without a result, or for each "camera, shot" without a
        detection.
    systematics : descriptions of the errors beyond noise that the covariance contains.
    notes : warnings for the user about the whole calibration.
    advice : sentence on the measurement that would reduce the sigmas; empty if there is none.
    gauge : names of the parameters that the observations do not determine.

    The following attributes are only set for boards in many shots. A shot is the set of images that
    all cameras take at one moment.

    reduced_chi_square : reduced chi-square of all observations, with their sigmas multiplied by
        `CameraFit.sigma_factor`.
    refused : sentences on shots and images that were not used.
    world : description of the shot or camera whose frame is that of the world.
    shots : names of the used shots.
    world_from_board : (s, 3, 4) pose of the board in each shot, mm; for a set, of its first board.
    reference_from_board : (b, 3, 4) pose of each board of a set relative to the first one, mm; the
        identity for one board. Its sigmas are those of "board.NAME.turn_x_deg", about the axes of
        the first board, and of "board.NAME.x_mm".
    place_shifts_mm : (n, 3) X, Y and Z displacement of each corner or circle centre from its
        position on the warped drawing, mm. It has no rows if the shots show no displacements.
    views : observation of the board by each camera in each shot, with the mask of used points.
    residuals_px : for each of `views`, (m, 2) predicted minus observed pixels of its corners or
        circles. With grey levels: of its circles and of the pieces of its lines, across the line.
    halves : comparison of two halves of the shots; None for too few shots.
    cross_validation : errors in shots that were not used in the fit; None for too few shots.
    solved_problem : the problem at its solution, for `next_shot`; None if the fit did not converge.
    is_lens : whether the result comes from `calibrate_intrinsics`. Its pose has no meaning, and it
        is saved as a lens.
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
        """True if at least one camera is determined, so that `rig` exists."""
        return self.solution is not None

    @property
    def rig(self) -> Rig:
        """Rig of the determined cameras, with the covariance of poses and lenses.

        Raises
        ------
        CalibrationError : no camera is determined. The error contains the reason.
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
        """The only camera. Raises `InputError` if there are several cameras."""
        return self.rig[self._only_camera()]

    @property
    def lens(self) -> Intrinsics:
        """Intrinsics of the only camera. Raises `InputError` if there are several cameras."""
        return self.camera.intrinsics

    @property
    def lens_parameters(self) -> tuple[str, ...]:
        """Names of the lens parameters of the only camera, such as "fx_px", in the order of
        `values`.
        """
        prefix = f"{self._only_camera()}."
        names = [name.removeprefix(prefix) for name in self.parameters if name.startswith(prefix)]
        pose_parameters = {parameter for model in PoseModel for parameter in model.parameter_names}
        return tuple(name for name in names if name not in pose_parameters)

    @property
    def lens_covariance(self) -> Float[np.ndarray, "q q"]:
        """Covariance of the lens parameters of the only camera, (q, q); 0 for fixed parameters.

        A lens without distortion has the parameters of the Brown-Conrady model.
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
        """The sheet or board. Raises `InputError` after a calibration from points."""
        if self.target is None:
            raise InputError("This camera was calibrated from points: it has no board.")
        return self.target

    @property
    def pattern(self) -> Pattern:
        """The sheet of circles. Raises `InputError` after a calibration from another board, or from
        points.
        """
        if not isinstance(self.board, Pattern):
            raise InputError(
                f"The board is a {type(self.board).__name__}, not a sheet of circles: use the "
                "attribute `board`."
            )
        return self.board

    @property
    def overall_status(self) -> Status:
        """Worst status of all cameras."""
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
        """Value of a parameter. Accepts the same names as `sigma` and raises the same errors."""
        row = self._row(parameter)
        return self.rig.value(parameter) if row is None else float(self.values[row])

    def rms_px(self, camera: str | None = None) -> float:
        """Root mean square length of the residuals that were used, px.

        camera : name of one camera. Default: residuals of all cameras.
        """
        fits = self.fits.values() if camera is None else [self.fits[camera]]
        residuals_px = [fit.residuals_px[fit.used] for fit in fits]
        used_px = np.concatenate([np.zeros((0, 2)), *residuals_px])
        return float(np.sqrt(np.mean(np.sum(used_px**2, axis=1)))) if len(used_px) else float("nan")

    @property
    def pairs(self) -> tuple[CameraPair, ...]:
        """Baseline and relative rotation of each pair of cameras, with sigmas. Empty if there is no
        rig.

        Pairs with the first camera come first.
        """
        if self.solution is None:
            return ()
        return camera_pairs(self.solution, self.parameters, self.covariance)

    @property
    def pixel_sigma(self) -> PixelSigma | None:
        """Standard deviation of the predicted pixel of a fixed point at the distance of the boards.

        None if there are no shots, or no rig.
        """
        if self.solution is None or not self.views:
            return None
        distances_mm = {name: self.board_distance_mm(name) for name in self.cameras}
        return compute_pixel_sigma(self.solution, self.parameters, self.covariance, distances_mm)

    @property
    def field_sigma_px(self) -> Float[np.ndarray, "5 5"]:
        """Standard deviation per axis of the pixel that the lens of the only camera predicts for a
        ray, px, (5, 5).

        The grid covers the image from corner to corner. Errors that a rotation of the camera would
        explain are removed. NaN where the lens has no ray, or if the lens is not determined.
        """
        camera = self._only_camera()
        if self.solution is None or self.solved_problem is None:
            return np.full((MAP_SIZE, MAP_SIZE), np.nan)
        lens = lens_of_index(self.solved_problem.problem, 0)
        rows = [self.parameters.index(f"{camera}.{name}") for name in lens.parameter_names]
        places_px = field_grid_px(self.lens.image_size_px)
        return np.asarray(field_sigma_px(lens, self.covariance[np.ix_(rows, rows)], places_px))

    def board_distance_mm(self, camera: str) -> float:
        """Median distance from a camera to the middle of the boards that it saw, mm.

        If the camera saw none, all boards are used. Raises `CalibrationError` if there is no rig.
        """
        camera_index = self.cameras.index(camera)
        used_views = [v for v in self.views if v.camera == camera_index and v.used.any()]
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
