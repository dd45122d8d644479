"""What the fit of many shots tells its user, in sentences: of one camera's lens, and of a rig."""

from collections.abc import Callable, Sequence

import numpy as np

from trinoc.calib.problem.coefficients import fewest_coefficients, free_of_lenses
from trinoc.calib.problem.lens_correction import correction_sentences
from trinoc.calib.problem.misfit_causes import CauseKind, MisfitCause
from trinoc.calib.problem.named_covariance import NamedCovariance
from trinoc.calib.problem.outcome import FitOutcome
from trinoc.calib.problem.problem import Problem, cam_from_board, lens_number
from trinoc.calib.problem.robust_fit import RobustFit, errors_px
from trinoc.calib.problem.status import Status
from trinoc.calib.starts.placing import boards_are_parallel
from trinoc.calib.targets.board_set import board_names, list_boards
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING
from trinoc.errors import list_names
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.geometry.pose import Pose

# The words for a camera's picture of a shot, by their numbers.
Where = Callable[[int, int], str]


def undetermined_sentence(problem: Problem, names: Sequence[str]) -> str:
    """Which parameters the shots do not determine, and why where that is plain."""
    return f"The shots do not determine {list_names(names, 8)}{_reason(problem)}."


def _reason(problem: Problem) -> str:
    used = [view for view in problem.views if view.used.any()]
    shots = {view.shot for view in used}
    if len(shots) == 1:
        return (
            ": there is one shot, and a plane tells two numbers of a lens and no more. Take more, "
            "the board tilted another way in each, or give the lenses"
        )
    facing = np.array([cam_from_board(problem.state, view).rotation[:, 2] for view in used])
    tilts_deg = np.degrees(np.arccos(np.clip(np.abs(facing[:, 2]), 0.0, 1.0)))
    if max(tilts_deg) < TUNING.starts.parallel_deg:
        return (
            ": all pictures show the board square to the camera, where a longer focal length and a "
            "larger distance look the same. Tilt the board by 30 to 50 degrees, another way each "
            "time"
        )
    boards = [Pose(np.asarray(problem.state.rig_from_board)[shot]) for shot in shots]
    if not len(problem.state.set_from_board) and boards_are_parallel(boards):
        return (
            ": the board is parallel in all shots. Tilt it by 30 to 50 degrees, another way each "
            "time"
        )
    tilted = facing[tilts_deg >= TUNING.starts.parallel_deg, :2]
    doubled = 2.0 * np.arctan2(tilted[:, 1], tilted[:, 0])
    alignment = np.hypot(np.mean(np.cos(doubled)), np.mean(np.sin(doubled)))
    if problem.cameras == 1 and alignment > np.cos(np.radians(2.0 * TUNING.starts.parallel_deg)):
        return ": the board is tilted about one axis only"
    return ": take more shots, the board tilted another way in each"


def list_refusals(fit: RobustFit, where: Where) -> tuple[str, ...]:
    """Pictures that show the board elsewhere, and how many places were located wrongly."""
    sentences = [
        f"{where(camera, shot)} shows the board {miss:.1f} px from where the rig has it, so the "
        "board moved or the picture is of another moment; it was left out."
        for camera, shot, miss in fit.elsewhere
    ]
    elsewhere = {(camera, shot) for camera, shot, _ in fit.elsewhere}
    for view in fit.problem.views:
        wrong = int((~view.used).sum())
        if wrong and (view.camera, view.shot) not in elsewhere:
            sentences.append(
                f"{where(view.camera, view.shot)}: {wrong} of {len(view.used)} places "
                f"{'was' if wrong == 1 else 'were'} located wrongly and left out."
            )
    return tuple(sentences)


def silent_sentences(silent: Sequence[tuple[int, int, str]], where: Where) -> tuple[str, ...]:
    """Pictures whose grey levels say nothing; (camera, shot, why) of each."""
    return tuple(
        f"{where(camera, shot)}: {why} Its places count as they were detected."
        for camera, shot, why in silent
    )


def notes_of_fit(
    fit: RobustFit,
    outcome: FitOutcome,
    gauge: Sequence[str],
    cameras: Sequence[str],
    held: Sequence[str],
    remarks: Sequence[str] = (),
    causes: Sequence[MisfitCause] = (),
    shots: Sequence[str] = (),
) -> tuple[str, ...]:
    """Sentences on what is not determined, and on lenses, board and shots.

    gauge : parameters that are open. held : coefficients that were given up. remarks : on the
    lens, before all but the first. causes : of large residuals. shots : names.
    """
    problem, variance_factor = fit.problem, outcome.variance_factor
    notes = []
    if outcome.status is Status.RANK_DEFICIENT:
        notes.append(undetermined_sentence(problem, gauge))
    elif outcome.status is Status.NOT_CONVERGED:
        notes.append(f"{outcome.status.value} See that all pictures show this board.")
    notes += [*remarks, *correction_sentences(problem, cameras)]
    notes += cause_sentences(causes, np.sqrt(variance_factor), cameras, shots)
    if held:
        notes.append(f"The shots cannot determine {', '.join(held)}, held at 0.")
    if problem.parametrization.has_circles:
        for camera, factor in zip(cameras, problem.sigma_factor, strict=True):
            if factor > np.sqrt(2.0):
                notes.append(
                    f"The circles of {camera} scatter {factor:.1f} times as much as their own "
                    "sigmas say; all sigmas are enlarged by that. See that the board is flat and "
                    "does not move, and that focus and zoom stay."
                )
    used = [view for view in problem.views if view.used.any()]
    poses = [cam_from_board(problem.state, view) for view in used]
    if poses and np.mean([p.rotation[:, 2] @ p.translation_mm > 0 for p in poses]) > 0.5:
        notes.append(
            "Most pictures show the board from behind: the board, its layout or the pictures are "
            "mirrored, unless it is of glass. Mirrored pictures make a mirrored rig."
        )
    shape = np.asarray(problem.state.shape)
    if len(shape):
        across, above = np.sqrt(np.mean(shape[:, :2] ** 2)), np.sqrt(np.mean(shape[:, 2] ** 2))
        notes.append(
            f"The board's places lie {across:.2g} mm aside of the drawing and {above:.2g} mm off "
            "its plane (root mean square); this was found with the rig, and is taken into account."
        )
    return (*notes, *_surprises(problem))


def cause_sentences(
    causes: Sequence[MisfitCause], scatter: float, cameras: Sequence[str], shots: Sequence[str]
) -> list[str]:
    """A sentence on each cause of large residuals; without a cause, by how much the shots disagree.

    scatter : standard deviation of the shots' pulls over what the residuals of their places give.
    """
    sentences = [_cause_sentence(cause, cameras, shots) for cause in causes]
    if scatter > 1.0:
        sentences.append(
            f"All sigmas are enlarged {scatter:.1f} times, because shots differ from each other by "
            "so much more than their residuals."
            + ("" if causes else " No single cause stands out in the residuals.")
        )
    return sentences


def scatter_sentence(camera: str, factor: float, has_causes: bool) -> str:
    """That the places of a camera scatter far more than their sigmas."""
    return f'The residuals of "{camera}" are {factor:.1f} times their sigmas: ' + (
        "see the causes below." if has_causes else "no single cause stands out in them."
    )


def _cause_sentence(cause: MisfitCause, cameras: Sequence[str], shots: Sequence[str]) -> str:
    camera = f'"{cameras[cause.camera]}"'
    size = f"{cause.amplitude_px:.2g} px (its residuals are {cause.noise_px:.2g} px rms)"
    if cause.kind is CauseKind.LENS_MODEL:
        return (
            f"The lens model of {camera} leaves a pattern of {size} that all images share: choose "
            "--lens-model auto or splined."
        )
    if cause.kind is CauseKind.BOARD_CHANGES:
        return (
            f"In {camera} the board is deformed differently in each image, by {size}: it bends, or "
            "moves during the exposure. Fix it to something stiff, and hold it still."
        )
    if cause.kind is CauseKind.CAMERA_MOVED:
        return (
            f'{camera} moved before the shot "{shots[cause.shot]}": from there on it shows the '
            f"board {cause.amplitude_px:.2g} px aside. Calibrate the shots before and after apart."
        )
    return (
        f"{camera} shows the board {size} from where the other cameras of the shot show it, in the "
        "median of all shots: the cameras do not look at one moment. Hold the board still in each "
        "shot, or trigger the cameras together."
    )


def _surprises(problem: Problem) -> list[str]:
    """Where the board is not as it was said to be."""
    information = np.asarray(problem.priors.sheet_information)
    free = np.flatnonzero(np.diag(information) > 0)
    sigmas = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(free, free)])))
    several, terms = len(list_boards(problem.target)) > 1, problem.parametrization.sheet_model.names
    names = [(whose, name) for whose in board_names(problem.target) for name in terms]
    sentences = []
    for row, value, sigma in zip(free, np.asarray(problem.state.sheet)[free], sigmas, strict=True):
        whose, name = names[row]
        if abs(value) > TUNING.answer.strain_sigmas * sigma:
            of = f" {whose}" if several else ""
            amount = f"{value:.2f} mm" if name.endswith("_mm") else f"{100 * value:.2f} %"
            sentences.append(
                f"The board{of}'s {name.removesuffix('_mm')} is {amount}, more than was thought "
                f"possible ({abs(value) / sigma:.0f} sigmas): check the layout and the size of its "
                "squares."
            )
    return sentences


def misfit_sentence(fit: RobustFit, places: str) -> str | None:
    """Why a lens must not be used although its fit ended, or None where it may be.

    places : "circles" or "corners".
    """
    views = fit.problem.views
    what = "this pattern" if places == "circles" else "this board"
    total, kept = sum(len(view.used) for view in views), sum(int(view.used.sum()) for view in views)
    remedy = (
        f"check that all pictures show {what} and were taken by one camera at one zoom and focus."
    )
    if 2 * kept < total:
        return f"Only {kept} of {total} {places} agree on one lens: {remedy}"
    errors = [each[view.used] for view, each in zip(views, errors_px(fit.problem), strict=True)]
    misfit_px = float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1))))
    extent_px = np.median([np.ptp(view.detection.centres_px, axis=0).max() for view in views])
    if misfit_px > max(
        TUNING.answer.least_misfit_px, TUNING.answer.misfit_share_of_lens * float(extent_px)
    ):
        return f"The {places} miss their predicted places by {misfit_px:.1f} px: {remedy}"
    return None


def notes_of_lens(problem: Problem, camera: str, named: NamedCovariance) -> tuple[str, ...]:
    """Sentences on the distortion of the only lens: coefficients too many, and places too few."""
    lens, notes = lens_number(problem, 0), []
    rows = [named.names.index(f"{camera}.{name}") for name in lens.parameter_names]
    covariance = named.covariance[np.ix_(rows, rows)]
    variance = dict(zip(lens.parameter_names, np.diag(covariance), strict=True))
    coefficients = [name for name in lens.coefficient_names if variance[name] > 0]
    if not coefficients or not free_of_lenses(problem).any():
        return ()
    if not isinstance(lens, AbstractSplinedLens):
        count, gain = fewest_coefficients(lens, coefficients, covariance)
        extra = [name for name in coefficients if name not in lens.coefficient_names[:count]]
        if extra:
            notes.append(coefficients_sentence(count, lens.coefficient_names, extra, gain))
    reach = reach_sentence(problem)
    return (*notes, *([] if reach is None else [reach]))


def reach_sentence(problem: Problem) -> str | None:
    """That the distortion of a lens is extrapolated, where no place lies near the corners."""
    places_px = np.concatenate([view.detection.centres_px for view in problem.views])
    middle = np.asarray(lens_number(problem, 0).principal_point_px)
    width, height = problem.image_sizes_px[0]
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
    reach, farthest = (np.linalg.norm(p - middle, axis=1).max() for p in (places_px, corners))
    if reach >= TUNING.answer.enough_reach * farthest:
        return None
    place = "circle" if isinstance(problem.target, Pattern) else "corner"
    return (
        f"No {place} lies further than {100 * reach / farthest:.0f} % of the way from the "
        "principal point to the corners: the distortion beyond is extrapolated."
    )


def coefficients_sentence(
    count: int, names: Sequence[str], extra: Sequence[str], gain: float
) -> str:
    """That the first `count` of a lens's coefficients suffice; what the `extra` ones gain."""
    one = len(extra) == 1
    return (
        f"The pictures ask for {', '.join(names[:count]) or 'no distortion'}; {', '.join(extra)} "
        f"lower{'s' if one else ''} chi-square by {gain:.1f}, no more than noise does: "
        f"distortion={count} would leave {'it' if one else 'them'} out."
    )
