"""The result of every calibration: a rig, its covariance, and the status and fit of each camera."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.image_quality import ImageQuality as ImageQuality
from trinoc.calib.problem.problem import EndedProblem, lens_number
from trinoc.calib.problem.status import Status as Status
from trinoc.calib.problem.views import View
from trinoc.calib.result.camera_pairs import CameraPair, camera_pairs
from trinoc.calib.result.halves import CrossValidation, HalvesCheck
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import list_boards
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, AnswerTuning
from trinoc.calib.uncertainty.pixel_sigma import PixelSigma, compute_pixel_sigma
from trinoc.calib.uncertainty.propagation import MAP_PLACES, field_places_px, field_sigma_px
from trinoc.errors import CalibrationError, InputError, list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import Rig
from trinoc.numerics.display import Displayable
from trinoc.numerics.values import Value


class Alternative(NamedTuple):
    """One thing that the model holds fixed, and what the residuals say of it.

    Fields
    ------
    name : "aim", "focal length", "aspect", "principal point" or "radial distortion".
    chi_square_drop : likelihood ratio against the model as it is.
    p_value : probability of such a drop by noise alone.
    estimate : of the change, in mm of aim, share of the focal length, that along v against that
        along u, px, or k1.
    sigma : of the estimate.
    sentence : what it means.
    strain : by how many of its sigmas the change would move the camera (Mahalanobis distance).
    unseen : of changes that the residuals may well not show, the one that moves the camera most.
    unseen_strain : by how many of its sigmas that would move the camera.
    unseen_motion : (p,) change of the camera's parameters by `unseen`, degrees and mm.
    tuning : chances and strains beyond which the test counts.
    """

    name: str
    chi_square_drop: float
    p_value: float
    estimate: Float[np.ndarray, "k"]
    sigma: Float[np.ndarray, "k"]
    sentence: str
    strain: float
    unseen: Float[np.ndarray, "k"]
    unseen_strain: float
    unseen_motion: Float[np.ndarray, "p"]
    tuning: AnswerTuning = TUNING.answer

    @property
    def found(self) -> bool:
        """Whether noise alone would hardly make it."""
        return self.p_value < self.tuning.chance

    @property
    def is_strained(self) -> bool:
        """Whether noise alone would rarely make it, and it would move the camera far."""
        is_rare = self.p_value < self.tuning.chance_where_strained
        return is_rare and self.strain > self.tuning.strain_sigmas


class CameraFit(Value):
    """The fit of one camera to its observations.

    Fields
    ------
    residuals_px : (m, 2) predicted minus observed pixel of each circle, corner or point, over all
        images of the camera.
    used : (m,) observations that took part in the fit; the others were located wrongly.
    rank : number of the camera's parameters that the observations determine.
    reduced_chi_square : chi-square of the circles or corners over their degrees of freedom.
    sigma_factor : residuals over their stated sigmas, by which these were multiplied; of points
        without a stated sigma, the standard deviation of a coordinate in px.
    gauge : names of the parameters that the observations leave free.
    notes : sentences on what a user should know (covered circles, dropped outliers, ...).
    detections : circles, corners and lines that were fitted, one for each image of the sheet;
        empty for points and for boards in many shots, whose detections `CalibrationResult.views`
        holds.
    image : fit of the grey levels, or None where the circles alone were fitted.
    alternatives : tests of everything that the model holds fixed.
    method : "pixels" where the grey levels were fitted, "points" where circles, corners or points
        were.
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
    alternatives: tuple[Alternative, ...] = ()
    method: str = eqx.field(static=True, default="points")

    def __check_init__(self) -> None:
        if len(self.residuals_px) != len(self.used):
            raise ValueError("residuals_px and used have a row for each observation.")

    @property
    def detection(self) -> Detection:
        """What was found in the camera's one image of a sheet."""
        (only,) = self.detections
        return only

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals of the observations that took part, px."""
        squared = np.sum(self.residuals_px[self.used] ** 2, axis=1)
        return float(np.sqrt(np.mean(squared))) if len(squared) else float("nan")


class CalibrationResult(Displayable, Value):
    """A calibrated rig with its parameters, their covariance, and the fit of each camera.

    Every calibration returns this type: `calibrate`, `calibrate_rig`, `calibrate_intrinsics` (a
    rig of one camera, in its own frame) and `calibrate_points` (a rig of one camera).

    Fields
    ------
    solution : the rig of all cameras whose parameters are determined, or None if none are. Read it
        as `rig`.
    status : how the fit of each camera ended, failed cameras included. Cameras that were fitted
        together share it.
    parameters : names such as "upper.pan_deg", "left.fx_px", "board.warp_x_mm".
    values : (p,) of `parameters`, in degrees, mm and px; NaN where not determined.
    covariance : (p, p) of `parameters`; 0 for what was held, NaN where not determined.
    fits : fit of each camera in whose images something was found.
    target : the sheet or board; None for points.
    failures : for each camera, or "camera, shot", without a result, a sentence that says why.
    systematics : the errors beyond noise that the covariance contains, in words.
    notes : sentences on what a user should know.
    advice : a sentence on what to know better, if that narrows the sigmas.
    gauge : names of the parameters that the observations leave free.

    Of boards in many shots:

    reduced_chi_square : of all observations, after their sigmas were multiplied by
        `CameraFit.sigma_factor`.
    refused : sentences on shots and images that were left out.
    world : the shot, or the camera, whose frame is the world's.
    shots : names of the shots that took part.
    world_from_board : (s, 3, 4) pose of the board in each shot, mm; of a set its first board.
    reference_from_board : (b, 3, 4) pose of each board of a set relative to the first one, mm; of
        one board no motion. Their sigmas are those of "board.NAME.turn_x_deg", about the axes of
        the first board, and of "board.NAME.x_mm".
    place_shifts_mm : (n, 3) distances of the board's corners or circles from its drawing and its
        warp, X, Y and Z; no rows where the shots do not show any.
    views : what each camera observed in each shot, by their numbers, and which corners or circles
        took part.
    residuals_px : for each view (m, 2) predicted minus observed corners or circles; where grey
        levels were fitted, each circle and, across it, each piece of a line.
    halves : comparison of two halves of the shots; None where there are too few.
    cross_validation : errors of shots that the rig was not fitted to; None where there are too few.
    ended : the problem at its end, from which `next_shot` goes on; None without one.
    is_lens : whether this is a lens, of `calibrate_intrinsics`, whose pose has no meaning; it is
        saved as one.
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
    views: tuple[View, ...] = ()
    residuals_px: tuple[Float[np.ndarray, "_m 2"], ...] = ()
    halves: HalvesCheck | None = None
    cross_validation: CrossValidation | None = None
    ended: EndedProblem | None = None
    is_lens: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        count = len(self.parameters)
        if self.values.shape != (count,) or self.covariance.shape != (count, count):
            raise ValueError("values and covariance have a row for each parameter.")
        if len(self.views) != len(self.residuals_px):
            raise ValueError("views and residuals_px have an entry for each other.")

    @property
    def has_rig(self) -> bool:
        """Whether any camera is determined, so that `rig` can be read."""
        return self.solution is not None

    @property
    def rig(self) -> Rig:
        """The determined cameras, with the covariance of poses and lenses.

        Raises
        ------
        CalibrationError : no camera is determined. The sentence says why.
        """
        if self.solution is None:
            why = self.notes[0] if self.notes else self.overall_status.value
            raise CalibrationError(f"No rig was determined. {why}", dict(self.failures), self)
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
        every = [name.removeprefix(prefix) for name in self.parameters if name.startswith(prefix)]
        poses = {each for model in PoseModel for each in model.parameter_names}
        return tuple(name for name in every if name not in poses)

    @property
    def lens_covariance(self) -> Float[np.ndarray, "q q"]:
        """Covariance of the parameters of the only lens; 0 for those that were held.

        The parameters of a lens without distortion are those of Brown and Conrady's model.
        """
        names = promote_lens(self.lens.lens).parameter_names
        rows = [self._row(f"{self._only_camera()}.{name}") for name in names]
        known = [k for k, row in enumerate(rows) if row is not None]
        covariance = np.zeros((len(names), len(names)))
        kept = [row for row in rows if row is not None]
        covariance[np.ix_(known, known)] = self.covariance[np.ix_(kept, kept)]
        return covariance

    @property
    def board(self) -> AbstractTarget:
        """The sheet or board. Raises InputError for points."""
        if self.target is None:
            raise InputError("This camera was calibrated from points, without a sheet.")
        return self.target

    @property
    def pattern(self) -> Pattern:
        """The sheet of circles. Raises InputError for another board, and for points."""
        if not isinstance(self.board, Pattern):
            raise InputError(f"The board is a {type(self.board).__name__}, no sheet of circles.")
        return self.board

    @property
    def overall_status(self) -> Status:
        """The worst status of all cameras."""
        return max(self.status.values(), key=list(Status).index)

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter such as "upper.pan_deg", or "fx_px" of a single camera.

        0 for a parameter that was held, NaN for one that is not known. Raises InputError for a name
        that is no parameter.
        """
        row = self._row(parameter)
        if row is None:
            return self.rig.sigma(parameter)
        return float(np.sqrt(self.covariance[row, row]))

    def value(self, parameter: str) -> float:
        """Value of a parameter, named as in `sigma`. Raises InputError for another name."""
        row = self._row(parameter)
        return self.rig.value(parameter) if row is None else float(self.values[row])

    def rms_px(self, camera: str | None = None) -> float:
        """Root mean square length of the residuals that took part, of one camera or of all, px."""
        fits = self.fits.values() if camera is None else [self.fits[camera]]
        residuals_px = [fit.residuals_px[fit.used] for fit in fits]
        every = np.concatenate([np.zeros((0, 2)), *residuals_px])
        return float(np.sqrt(np.mean(np.sum(every**2, axis=1)))) if len(every) else float("nan")

    @property
    def pairs(self) -> tuple[CameraPair, ...]:
        """Baseline and relative rotation of each pair of cameras, with sigmas; none without a rig.

        The first camera with each other one comes first.
        """
        if self.solution is None:
            return ()
        return camera_pairs(self.solution, self.parameters, self.covariance)

    @property
    def pixel_sigma(self) -> PixelSigma | None:
        """Standard deviation of a pixel at the distance of the boards; None without shots."""
        if self.solution is None or not self.views:
            return None
        distances_mm = {name: self.board_distance_mm(name) for name in self.cameras}
        return compute_pixel_sigma(self.solution, self.parameters, self.covariance, distances_mm)

    @property
    def field_sigma_px(self) -> Float[np.ndarray, "5 5"]:
        """Standard deviation per axis of the pixel at which the only lens images a ray, px.

        From corner to corner of the image, a common turn of the camera taken out. NaN where the
        lens images no ray, or is not determined.
        """
        camera = self._only_camera()
        if self.solution is None or self.ended is None:
            return np.full((MAP_PLACES, MAP_PLACES), np.nan)
        lens = lens_number(self.ended.problem, 0)
        rows = [self.parameters.index(f"{camera}.{name}") for name in lens.parameter_names]
        places_px = field_places_px(self.lens.image_size_px)
        return np.asarray(field_sigma_px(lens, self.covariance[np.ix_(rows, rows)], places_px))

    def board_distance_mm(self, camera: str) -> float:
        """Median distance from a camera to the middle of the boards that it saw, or of all boards.

        Raises CalibrationError without a rig.
        """
        number = self.cameras.index(camera)
        used = [v for v in self.views if v.camera == number and v.used.any()]
        pairs = {(view.shot, view.board) for view in used}
        pairs = pairs or {(shot, 0) for shot in range(len(self.world_from_board))}
        shots, boards = np.array(sorted(pairs)).T
        extents = [np.asarray(board.centres_mm) for board in list_boards(self.board)]
        middles = np.stack([(each.min(axis=0) + each.max(axis=0)) / 2 for each in extents])
        fixed, poses = self.reference_from_board, self.world_from_board[shots]
        middles = np.einsum("bij,bj->bi", fixed[:, :, :2], middles) + fixed[:, :, 3]
        middles_mm = np.einsum("sij,sj->si", poses[:, :, :3], middles[boards]) + poses[:, :, 3]
        centre = np.asarray(self.rig[camera].centre_world_mm)
        return float(np.median(np.linalg.norm(middles_mm - centre, axis=1)))

    def summary(self) -> str:
        """The parameters with their standard deviations, and how good each fit is, as text."""
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
