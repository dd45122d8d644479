"""A rig from many shots, which never travels without its status and its sigmas."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.problem import EndedProblem
from trinoc.calib.problem.views import View
from trinoc.calib.result.calibration import Status
from trinoc.calib.result.camera_pairs import CameraPair, camera_pairs
from trinoc.calib.result.halves import CrossValidation, HalvesCheck
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import IN_SET_NAMES, board_names, list_boards
from trinoc.calib.uncertainty.pixel_sigma import PixelSigma, compute_pixel_sigma
from trinoc.errors import InputError
from trinoc.geometry.lenses.splined import SPLINE_PARAMETERS
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.numerics.values import Value


class RigFromShots(Value):
    """Lenses and cameras fitted together, with their covariance, and what each shot said.

    Fields
    ------
    rig : the cameras in the world, with a covariance that holds their lenses, too; None unless
        `status` is CONVERGED or SUSPECT, and None if a fitted lens folds its image before what was
        observed, or leaves too little of it.
    status : how the fit ended; SUSPECT where the shots refute a lens that was given, or if a fitted
        lens folds its image like that. Of a fold farther out, a note says what it costs.
    parameters : names such as "left.pan_deg", "left.fx_px", "board.warp_x_mm".
    values : (p,) of `parameters`; NaN where not determined.
    covariance : (p, p), degrees, mm and px; zero for what was held, NaN where not determined.
    gauge : the parameters that the shots leave open.
    world : the shot, or the camera, that is the world's frame.
    target : the board.
    shots : names of the shots that took part.
    world_from_board : (s, 3, 4) the board in each shot, mm; of a set its first one.
    reference_from_board : (b, 3, 4) how each board of a set is fixed to the first one, mm; of one
        board no motion. Their sigmas are those of "board.NAME.turn_x_deg", about the axes of the
        first one from where each stands, and of "board.NAME.x_mm", where its origin lies.
    place_shifts_mm : (n, 3) by which each place of the board lies elsewhere than its drawing and
        its warp have it, X, Y and Z; no rows where the shots do not show it.
    views : what each camera saw in each shot, by their indices, and which places took part.
    residuals_px : for each view (m, 2) predicted minus observed, of its places, or of what its
        grey levels show: each circle and, across it, each piece of a line.
    sigma_factor : for each camera by how much its places scatter more than their sigmas say.
    reduced_chi_square : after the sigmas were multiplied by it.
    halves : two halves of the shots compared, or None where there are too few.
    failures : for "camera, shot" in which the board was not found, why.
    refused : sentences on shots and pictures that were left out.
    systematics : the errors of the board that the covariance holds, in words.
    notes : sentences on what a user should know.
    cross_validation : errors of shots that the rig was not fitted to; None where there are too few.
    ended : where the fit ended, in its own units, which `next_shot` goes on from; None where `rig`
        is.
    """

    rig: Rig | None
    status: Status
    parameters: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    gauge: tuple[str, ...] = eqx.field(static=True)
    world: str = eqx.field(static=True)
    target: AbstractTarget
    cameras: tuple[str, ...] = eqx.field(static=True)
    shots: tuple[str, ...] = eqx.field(static=True)
    world_from_board: Float[np.ndarray, "s 3 4"]
    reference_from_board: Float[np.ndarray, "b 3 4"]
    place_shifts_mm: Float[np.ndarray, "n 3"]
    views: tuple[View, ...]
    residuals_px: tuple[Float[np.ndarray, "_m 2"], ...]
    sigma_factor: dict[str, float] = eqx.field(static=True)
    reduced_chi_square: float = eqx.field(static=True)
    halves: HalvesCheck | None
    failures: dict[str, str] = eqx.field(static=True)
    refused: tuple[str, ...] = eqx.field(static=True)
    systematics: tuple[str, ...] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)
    cross_validation: CrossValidation | None = None
    ended: EndedProblem | None = None

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter such as "left.fx_px"; 0 if held, NaN if not known."""
        row = self.parameters.index(parameter)
        return float(np.sqrt(self.covariance[row, row]))

    def value(self, parameter: str) -> float:
        """Value of a parameter such as "left.fx_px"."""
        return float(self.values[self.parameters.index(parameter)])

    @property
    def pairs(self) -> tuple[CameraPair, ...]:
        """Baseline and relative rotation of each pair of cameras, with sigmas; none without a rig.

        The first camera with each other one comes first.
        """
        if self.rig is None:
            return ()
        return camera_pairs(self.rig, self.parameters, self.covariance)

    @property
    def pixel_sigma(self) -> PixelSigma | None:
        """How well a pixel is known at the distance of the boards; None without a rig."""
        if self.rig is None:
            return None
        distances_mm = {name: self.board_distance_mm(name) for name in self.cameras}
        return compute_pixel_sigma(self.rig, self.parameters, self.covariance, distances_mm)

    def board_distance_mm(self, camera: str) -> float:
        """Median distance from a camera to the middle of the boards that it saw; of all boards if
        it saw none. Raises InputError without a rig."""
        if self.rig is None:
            raise InputError(f"There is no rig, and so no distances: {self.status.value}")
        number = self.cameras.index(camera)
        used = [v for v in self.views if v.camera == number and v.used.any()]
        seen = {(view.shot, view.board) for view in used}
        seen = seen or {(shot, 0) for shot in range(len(self.world_from_board))}
        shots, boards = np.array(sorted(seen)).T
        poses = self.world_from_board[shots]
        extents = [np.asarray(board.centres_mm) for board in list_boards(self.target)]
        middles = np.stack([(own.min(axis=0) + own.max(axis=0)) / 2 for own in extents])
        fixed = self.reference_from_board
        middles = np.einsum("bij,bj->bi", fixed[:, :, :2], middles) + fixed[:, :, 3]
        places = np.einsum("sij,sj->si", poses[:, :, :3], middles[boards]) + poses[:, :, 3]
        centre = np.asarray(self.rig[camera].centre_world_mm)
        return float(np.median(np.linalg.norm(places - centre, axis=1)))

    @property
    def fixed_boards(self) -> tuple[str, ...]:
        """A sentence on where each board of a set is fixed to the first one, with sigmas."""
        if self.rig is None:
            return ()
        reference, *others = board_names(self.target)
        return tuple(
            _board_sentence(self, name, reference, pose)
            for name, pose in zip(others, self.reference_from_board[1:], strict=True)
        )

    def rms_px(self, camera: str | None = None) -> float:
        """Root mean square length of the residuals of one camera, or of all."""
        kept = [
            errors[view.kept]
            for view, errors in zip(self.views, self.residuals_px, strict=True)
            if camera in (None, self.cameras[view.camera])
        ]
        every = np.concatenate([np.zeros((0, 2)), *kept])
        return float(np.sqrt(np.mean(np.sum(every**2, axis=1)))) if len(every) else float("nan")

    def summary(self) -> str:
        """The lenses and cameras with their sigmas, and how good the fit is, as text."""
        return summarise_shots(self)


def summarise_shots(result: RigFromShots) -> str:
    """A block for each camera, then the board and what a user should know."""
    lines = [f"SUSPECT: {result.notes[0]}"] if result.status is Status.SUSPECT else []
    for number, camera in enumerate(result.cameras):
        own = [view for view in result.views if view.camera == number and view.used.any()]
        places = sum(int(view.used.sum()) for view in own)
        pictures = len({view.shot for view in own})
        lines.append(
            f"{camera}: {places} places in {pictures} pictures, rms {result.rms_px(camera):.3f} px,"
            f" sigmas x {result.sigma_factor[camera]:.2f}"
        )
        lines += [
            f"  {key:12} {_words(result, name)}"
            for name in result.parameters
            for owner, _, key in (name.rpartition("."),)
            if owner == camera and result.sigma(name) != 0.0 and key not in SPLINE_PARAMETERS
        ]
    lines += [
        f"{name:14} {_words(result, name)}"
        for name in result.parameters
        if name.startswith("board.")
        and name.rpartition(".")[2] not in IN_SET_NAMES
        and result.sigma(name) != 0.0
    ]
    lines += result.fixed_boards
    lines.append(f"world: {result.world}")
    lines += [_pair_sentence(pair) for pair in result.pairs[: len(result.cameras) - 1]]
    lines.append(
        f"scale: taken from the board, {_extent(result.target)} mm from the first to the last "
        "corner or circle centre; no image can check it"
    )
    if result.pixel_sigma is not None:
        lines.append(result.pixel_sigma.sentence)
    if result.halves is not None:
        lines.append(
            f"halves of the shots differ by {result.halves.ratio:.2f} claimed sigmas over "
            f"{result.halves.parameters} parameters (most in {result.halves.worst}: "
            f"{result.halves.worst_ratio:.1f})"
        )
    if result.cross_validation is not None:
        lines.append(result.cross_validation.sentence)
    lines.append(f"sigmas include {', '.join(('noise', *result.systematics))}.")
    lines += list(result.notes) + list(result.refused)
    lines += [f"{where}: {why}" for where, why in result.failures.items()]
    return "\n".join(lines)


def _pair_sentence(pair: CameraPair) -> str:
    """Baseline and relative rotation of two cameras, with sigmas."""
    baseline = value_words(pair.baseline_mm, pair.baseline_sigma_mm)
    if pair.size_sigma_mm > pair.rest_sigma_mm:
        baseline += (
            f" mm ({_two_digits(pair.size_sigma_mm)} by the board's size, "
            f"{_two_digits(pair.rest_sigma_mm)} by everything else)"
        )
    else:
        baseline += " mm"
    turns = ", ".join(
        f"{axis} {value_words(value, sigma)}"
        for axis, value, sigma in zip("xyz", pair.turn_deg, pair.turn_sigma_deg, strict=True)
    )
    return (
        f"{pair.first} to {pair.second}: baseline {baseline}, rotation "
        f"{value_words(pair.angle_deg, pair.angle_sigma_deg)} degrees ({turns} about the axes of "
        f"{pair.first})"
    )


def _two_digits(value: float) -> str:
    """A positive number with two significant digits, without an exponent."""
    if not (np.isfinite(value) and value > 0.0):
        return "0"
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(value))))}f}"


def _extent(target: AbstractTarget) -> str:
    sides = [np.ptp(board.centres_mm, axis=0) for board in list_boards(target)]
    return ", ".join(" x ".join(f"{side:.6g}" for side in own) for own in sides)


def _words(result: RigFromShots, name: str) -> str:
    return value_words(result.value(name), result.sigma(name))


def _board_sentence(
    result: RigFromShots, name: str, reference: str, reference_from_board: Float[np.ndarray, "3 4"]
) -> str:
    """Where a board's origin lies in the frame of another, and by how much it is turned."""
    pose = Pose(reference_from_board)
    cosine = np.clip(0.5 * (np.trace(pose.rotation) - 1.0), -1.0, 1.0)
    places = ", ".join(
        f"{axis} {value_words(value, result.sigma(f'board.{name}.{axis}_mm'))}"
        for axis, value in zip("xyz", pose.translation_mm, strict=True)
    )
    turns = ", ".join(f"{result.sigma(f'board.{name}.turn_{axis}_deg'):.2g}" for axis in "xyz")
    return (
        f'"{name}" lies at {places} mm in the frame of "{reference}", turned by '
        f"{np.degrees(np.arccos(cosine)):.2f} degrees (+- {turns} about x, y, z)"
    )


def value_words(value: float, sigma: float) -> str:
    """A value with as many decimals as its sigma warrants; one without sigma was held."""
    if not (np.isfinite(value) and np.isfinite(sigma)):
        return "not determined"
    decimals = max(0, 1 - int(np.floor(np.log10(sigma)))) if sigma > 0 else 3
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"
